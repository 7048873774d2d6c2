"""What must hold for any input: a clean error that names the line, or the same print.

A defect is an AssertionError, or any exception that is no HframeError.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from random import Random

import numpy as np

from hframe_post.arrays import Z
from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import SampleStream
from hframe_post.errors import GcodeError, HframeError, LimitError
from hframe_post.gcode.state import Extrusion
from hframe_post.identification.recordings import accelerometer, excitation
from hframe_post.planner.lookahead import MELTED
from hframe_post.printer.profile import load, parse, played_by, shipped
from hframe_post.printer.settings import Extruder, Printer
from hframe_post.writers.stream.print_time import DURATION, ELAPSED, DeferredLine
from tests.conftest import SAMPLES
from tests.fuzz import files, mutations, settings
from tests.fuzz.arcs import arcs
from tests.fuzz.machine import SHORT, UNSEEN, Machine, Stand

FILAMENT = 2e-3  # mm at any mark
# Marks between which the command goes less than a millisecond or a micrometre are at one place.
# What the fastest extruder feeds there may be on the other side of one: nothing in a print that a
# nozzle can lay, where it is less than FILAMENT.
SHARED = 2.0  # ms
BEYOND = 0.06  # mm from the path where the machine is released: what settles, and rounding
LONGER = 1.5  # times a segment of the command, that of the path may be
OFF = 6.0  # mm from the path in motion: the command leads the nozzle
PASSED = 0.26  # mm of filament per mm that Klipper lets pass of a nozzle of 0.4 mm
STEEPER = 2.0  # times as much as in the file there may be, and it must still let it pass
ELSEWHERE = 6.0  # times as much as in the file, for other firmwares: the nozzle lays it evenly
ROUND = 0.0075  # mm from a circle: chords, and half of the file's last digit
ADVANCES = re.compile(rb"M900[^;\n]*?K(\d*\.?\d+)", re.IGNORECASE)
BOM = b"\xef\xbb\xbf"
WRITTEN = re.compile(rb"G1(?: [XYZE]-?\d+(?:\.\d+)?)*(?: F\d+(?:\.\d+)?)?")
WITHOUT_LINE = (
    "empty", "not a single move", "binary", "not a text file", "UTF-16", "mm of filament",
)  # fmt: skip
EXTRUSIONS: tuple[Extrusion, ...] = ("absolute", "relative")
FIRMWARES = ("klipper", "marlin")


@cache
def printer(firmware: str) -> Printer:
    """The paper's printer with that firmware."""
    return {
        "klipper": partial(load, "paper"),
        "marlin": partial(load, "paper-marlin"),
    }[firmware]()


def converted(text: bytes, firmware: str, options: Options, advance: float = 0.0) -> bytes:
    """Return the output for a file. advance: pressure advance, s. Raises HframeError."""
    lines = text.splitlines(keepends=True) if b"\r" not in text else _lines(text)
    own = replace(printer(firmware), extruder=Extruder(advance))
    output = GcodeConversion(iter(lines), own, options)
    return b"".join(o.line + b"\n" if isinstance(o, DeferredLine) else o for o in output)


def _lines(text: bytes) -> list[bytes]:
    """Return lines as a file yields them: a carriage return alone does not end one."""
    return re.findall(rb"[^\n]*\n|[^\n]+", text)


def check_gcode(seed: int, seeds: list[bytes]) -> tuple[str, bytes, bytes]:
    """Check one mutated file; return the outcome, and the file and output that Klipper can play.

    The output is empty if it is for another firmware, or if the file was refused.
    """
    rng = Random(seed)
    text = mutations.gcode(rng, seeds)
    firmware = rng.choice(("klipper", "klipper", "klipper", "marlin"))
    strategy, clamp = rng.choice(("racking", "racking", "fbs", "none")), rng.random() < 0.2
    # E where the file sets no mode: by option, or detected from the moves
    extrusion: Extrusion | None = rng.choice(("absolute", "absolute", "relative", None))
    advance = rng.choice((0.0, 0.05))
    options = Options(strategy, clamp=clamp, extrusion=extrusion)
    try:
        output = converted(text, firmware, options, advance)
    except HframeError as error:
        check_error(error)
        return f"refused: {type(error).__name__}", text, b""
    if extrusion is None:
        extrusion = _detected(text, output, firmware, options, advance)
        if extrusion is None:
            return "converted: E set by a macro", text, b""
    check_same_print(text, output, firmware, extrusion, advance)
    begin = b"M83\n" if extrusion == "relative" else b""  # Klipper does not know the option
    played = begin + output if firmware == "klipper" else b""
    return f"converted: {firmware}", begin + text.removeprefix(BOM), played


def _detected(
    text: bytes, output: bytes, firmware: str, options: Options, advance: float
) -> Extrusion | None:
    """Return which mode of E the tool detected: the option that gives the same output.

    The stamp may differ. None: a macro may have changed the mode.
    """
    for extrusion in EXTRUSIONS:
        with contextlib.suppress(HframeError):
            asked = replace(options, extrusion=extrusion)
            other = converted(text, firmware, asked, advance)
            if other.partition(b"\n")[2] == output.partition(b"\n")[2]:
                return extrusion
    assert re.search(rb"^\s*(?:[Nn]\d+)?\s*[^;GMT\s]", text, re.MULTILINE | re.IGNORECASE)
    return None


def check_error(error: HframeError) -> None:
    """Assert that an error names its line or concerns the whole file."""
    message = str(error)
    assert message.isprintable(), message
    assert len(message) < 6000, message
    if isinstance(error, GcodeError | LimitError):
        assert "line " in message or any(cause in message for cause in WITHOUT_LINE), message
    assert "would be lost" not in message, message
    assert "report this" not in message, message


def check_same_print(
    text: bytes, output: bytes, firmware: str, extrusion: Extrusion = "absolute",
    advance: float = 0.0,
) -> None:  # fmt: skip
    """Assert equal marks and comments in order, and equal filament, modes and places at marks.

    extrusion: what E is before the first M82 or M83. advance: pressure advance, s, by which E is
    ahead in motion where it is computed into E.
    """
    asked, written = (
        Machine(firmware, absolute_e=extrusion == "absolute").play(each) for each in (text, output)
    )
    numbers = [stand.number for stand in asked.stands]
    assert [stand.number for stand in written.stands] == numbers, "marks are lost or out of order"
    _check_comments(text, output)
    longest = max([advance, *map(float, ADVANCES.findall(text))])
    ahead = longest * min(asked.flow, MELTED)
    at_rest = {int(n) for n in re.findall(rb"^UNHEARD_OF @(\d+)", text, re.MULTILINE)}
    for before, after in zip(asked.stands, written.stands, strict=True):
        off = after.filament - before.filament
        known = FILAMENT + 1e-3 * SHARED * min(asked.flow, MELTED)
        low, high = -known, known
        if firmware == "marlin" and before.number not in at_rest:
            least, most = _fed_at_segment(asked, before, after)
            low, high = low + least - before.filament, high + most - before.filament + ahead
        assert low < off < high, f"filament at mark {before.number} differs by {off:.5f} mm"
        if before.number in at_rest:
            assert after.modes == before.modes, f"modes differ at mark {before.number}"
            assert abs(after.e - before.e) < FILAMENT, f"E differs at mark {before.number}"
            _check_places(before.number, before.reported, after.reported, BEYOND)
        close = BEYOND if before.number in at_rest else OFF
        _check_places(before.number, before.place, after.place, close)
    now, then = (written.absolute, written.absolute_e), (asked.absolute, asked.absolute_e)
    assert now == then, "modes differ at the end"
    total = written.filament - asked.filament
    assert abs(total) < FILAMENT, f"filament differs by {total:.5f} mm at the end"
    assert written.standing < asked.nearly + UNSEEN, "filament is extruded without motion"
    if max(asked.sharpest, asked.nearly) < PASSED / STEEPER:
        most = PASSED if firmware == "klipper" else max(PASSED, ELSEWHERE * asked.sharpest)
        assert written.steepest < most, "filament is extruded almost without motion"
    travel = printer(firmware).travel
    for axis, (low, high) in enumerate((travel.x, travel.y)):
        assert low - 1e-3 <= written.least[axis], "off the bed"
        assert written.greatest[axis] <= high + 1e-3, "off the bed"
    known_lines = set(text.removeprefix(BOM).splitlines())
    for line in output.splitlines():
        if line.startswith(b"G1 ") and line not in known_lines:
            assert WRITTEN.fullmatch(line), line


def _fed_at_segment(asked: Machine, before: Stand, after: Stand) -> tuple[float, float]:
    """Return the least and the most filament that may be out at a mark in motion, for Marlin.

    The mark stands before the segment in which its place is. Within that segment lies about as much
    path as it is long, or, where it cuts off a swing of the command that is too short for a segment
    of its own, as much path as takes its filament.
    """
    least, most = asked.fed_before(before, LONGER * after.way + BEYOND)
    if after.way < SHORT:  # a retraction: the mark stands at rest
        return least, most
    lowest, highest = asked.fed_before(before, math.inf)
    return (
        min(least, max(lowest, before.filament - max(after.fed, 0.0))),
        max(most, min(highest, before.filament - min(after.fed, 0.0))),
    )


def _check_comments(text: bytes, output: bytes) -> None:
    """Assert that comments, except print times, pass byte for byte and in order."""
    rest = iter(_comments(output))
    for line in _comments(text.removeprefix(BOM)):
        assert any(line == other for other in rest), f"{line[:80]!r} is lost or out of order"


def _comments(text: bytes) -> Iterable[bytes]:
    for line in text.split(b"\n"):
        if line.startswith(b";") and not DURATION.match(line) and not ELAPSED.match(line):
            yield from re.findall(rb"^;[^\r]*", line)  # firmware may end the line there


def _check_places(
    number: int, asked: tuple[float | None, ...], written: tuple[float | None, ...], close: float
) -> None:
    for before, after in zip(asked, written, strict=True):
        if before is not None and after is not None:
            assert abs(after - before) < close, (
                f"place at mark {number} is {after} instead of {before}"
            )


def check_arcs(seed: int) -> tuple[str, bytes, bytes]:
    """Check ten arcs: their path must be on the circles about the centres in the file.

    Return the outcome, the file, and the output for Klipper without compensation.
    """
    text, known = arcs(Random(seed))
    lines = text.splitlines(keepends=True)
    commands = SampleStream(iter(lines), printer("klipper"), Options("none")).computed()
    chunks = [(c.line, c.xyze[:, : Z + 1]) for c in commands]
    check_same_print(text, converted(text, "klipper", Options("racking", clamp=True)), "klipper")
    line, xyz = (np.concatenate(part) for part in zip(*chunks, strict=True))
    for number, circle in known.items():
        on = xyz[np.flatnonzero(line == number)]
        dx, dy = on[:, 0] - circle.x, on[:, 1] - circle.y
        off = float(np.abs(np.hypot(dx, dy) - circle.radius).max(initial=0.0))
        assert off < ROUND, f"line {number}: {off:.4f} mm from its circle"
        turned = abs(float(np.diff(np.unwrap(np.arctan2(dy, dx))).sum()))
        ends = 30.0 * ROUND / circle.radius  # of the first and last millisecond, and of rounding
        short = circle.sweep - turned
        assert abs(short) < ends + 0.12 / circle.radius, f"line {number}: {short:.4f} rad missing"
        low, high = circle.z
        assert on[:, Z].min(initial=low) > low - 1e-9, f"line {number}: z out of range"
        assert on[:, Z].max(initial=high) < high + 1e-9, f"line {number}: z out of range"
    return "arcs", text, converted(text, "klipper", Options("none"))


def check_profile(seed: int) -> str:
    """Check a mutated profile: an error, or a printer with which a file is converted or refused."""
    rng = Random(seed)
    text = settings.profile(rng, list(shipped().values()))
    lines = (SAMPLES / "rectangle.gcode").read_bytes().splitlines(keepends=True)
    try:
        mutated = replace(parse(text, "mutated"), name="mutated")
        options = Options("racking", clamp=rng.random() < 0.5)
        for _ in GcodeConversion(iter(lines), mutated, options):
            pass
        played_by(mutated, "klipper")
    except HframeError as error:
        check_error(error)
        return f"refused: {type(error).__name__}"
    return "converted"


def check_table(seed: int, tables: list[bytes], folder: Path) -> str:
    """Check a mutated recording or command file: an error, or finite numbers."""
    rng = Random(seed)
    path = folder / f"{seed}.csv"
    path.write_bytes(settings.table(rng, rng.choice(tables)))
    try:
        if rng.random() < 0.5:
            excitation.read_command(path)
        else:
            accelerometer.read(path)
    except HframeError as error:
        check_error(error)
        return f"refused: {type(error).__name__}"
    finally:
        path.unlink()
    return "read"


def check_file(seed: int, folder: Path) -> str:
    """Check a mutated file of another kind: an error, or it is read."""
    path, reader = files.case(Random(seed), folder)
    try:
        reader(path)
    except HframeError as error:
        check_error(error)
        return f"refused: {path.suffix}"
    return f"read: {path.suffix}"
