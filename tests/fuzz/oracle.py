"""What must hold for any input: a clean error that names the line, or the same print.

A defect is an AssertionError, or any exception that is no HframeError.
"""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np

from hframe_post.arrays import Z
from hframe_post.conversion.pipeline import Commands, GcodeConversion, Options
from hframe_post.errors import GcodeError, HframeError, LimitError
from hframe_post.identification import accelerometer, command_file
from hframe_post.printer.profile import load, parse, played_by, shipped
from hframe_post.writers.deferred import DeferredLine
from tests.conftest import SAMPLES
from tests.fuzz import mutations
from tests.fuzz.machine import Machine

SECONDS, BYTES = 60, 200 << 20  # of one case: generous, other cases run beside it
FILAMENT = 2e-3  # mm at any mark
WAITED = 0.5  # of the most in a line: for Marlin a mark waits for the end of a segment
BEYOND = 0.06  # mm from the path where the machine is released: what settles, and rounding
OFF = 6.0  # mm from the path in motion: the command leads the nozzle
WRITTEN = re.compile(rb"G1(?: [XYZE]-?\d+(?:\.\d+)?)*(?: F\d+(?:\.\d+)?)?")
WITHOUT_LINE = ("empty", "not a single move", "binary", "not a text file", "mm of filament")


@contextmanager
def bounded() -> Iterator[None]:
    """Fails a case that takes too long."""

    def late(number: int, frame: object) -> None:
        raise TimeoutError(f"more than {SECONDS} s")

    before = signal.signal(signal.SIGALRM, late)
    Path("/proc/self/clear_refs").write_text("5")  # the peak counts from now on
    held = _kilobytes("VmRSS")
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert (_kilobytes("VmHWM") - held) << 10 < BYTES, "memory"


def _kilobytes(name: str) -> int:
    found = re.search(rf"{name}:\s*(\d+) kB", Path("/proc/self/status").read_text())
    assert found
    return int(found[1])


def converted(text: bytes, marlin: bool, options: Options) -> bytes:
    """The output for a file. Raises HframeError."""
    printer = load("paper-marlin" if marlin else "paper")
    lines = text.splitlines(keepends=True)
    output = GcodeConversion(iter(lines), printer, options)
    return b"".join(o.line + b"\n" if isinstance(o, DeferredLine) else o for o in output)


def check_gcode(seed: int, seeds: list[bytes]) -> str:
    """One mutated file; what came of it, in a word."""
    rng = Random(seed)
    text, marlin = mutations.gcode(rng, seeds), rng.random() < 0.3
    options = Options(rng.choice(("racking", "racking", "fbs", "none")), clamp=rng.random() < 0.2)
    try:
        with bounded():
            output = converted(text, marlin, options)
    except HframeError as error:
        check_error(error)
        return f"refused: {type(error).__name__}"
    check_same_print(text, output, marlin)
    return "converted"


def check_error(error: HframeError) -> None:
    """It names the line, or is about the whole file."""
    told = str(error)
    assert told.isprintable(), told
    assert len(told) < 6000, told
    if isinstance(error, GcodeError | LimitError):
        assert error.line or any(cause in told for cause in WITHOUT_LINE), told
    assert "would be lost" not in told, told


def check_same_print(text: bytes, output: bytes, marlin: bool) -> None:
    """Every mark, in order, with the filament, modes and places it had."""
    asked, written = Machine(marlin).play(text), Machine(marlin).play(output)
    numbers = [stand.number for stand in asked.stands]
    assert [stand.number for stand in written.stands] == numbers, "marks"
    released = b"UNHEARD_OF"
    at_rest = (
        {int(n) for n in re.findall(rb"^UNHEARD_OF @(\d+)", text, re.MULTILINE)}
        if released in text
        else set()
    )
    for before, after in zip(asked.stands, written.stands, strict=True):
        off = after.filament - before.filament
        waits = marlin and before.number not in at_rest
        known = FILAMENT + (WAITED * asked.most if waits else 0.0)
        assert abs(off) < known, f"filament at mark {before.number}: {off:.5f} mm off"
        if before.number in at_rest:
            assert after.modes == before.modes, f"modes at mark {before.number}"
            assert abs(after.e - before.e) < FILAMENT, f"e at mark {before.number}"
            _check_places(before.number, before.told, after.told, BEYOND)
        close = BEYOND if before.number in at_rest else OFF
        _check_places(before.number, before.place, after.place, close)
    now, then = (written.absolute, written.absolute_e), (asked.absolute, asked.absolute_e)
    assert now == then, "modes at the end"
    total = written.filament - asked.filament
    assert abs(total) < FILAMENT, f"{total:.5f} mm of filament off at the end"
    travel = load("paper").travel
    for axis, (low, high) in enumerate((travel.x, travel.y)):
        assert low - 1e-3 <= written.least[axis], "off the bed"
        assert written.greatest[axis] <= high + 1e-3, "off the bed"
    for line in output.splitlines():
        if line.startswith(b"G1 ") and line not in text:
            assert WRITTEN.fullmatch(line), line


def _check_places(
    number: int, asked: tuple[float | None, ...], written: tuple[float | None, ...], close: float
) -> None:
    for before, after in zip(asked, written, strict=True):
        if before is not None and after is not None:
            assert abs(after - before) < close, f"place at mark {number}: {before} became {after}"


def check_arcs(seed: int) -> str:
    """Ten arcs: the path lies on the circles about the centres that the file gives."""
    text, known = mutations.arcs(Random(seed))
    lines = text.splitlines(keepends=True)
    with bounded():
        commands = Commands(iter(lines), load("paper"), Options("none")).computed()
        chunks = [(c.line, c.xyze[:, :Z]) for c in commands]
        output = converted(text, False, Options("racking", clamp=True))
    check_same_print(text, output, marlin=False)
    line, xy = (np.concatenate(part) for part in zip(*chunks, strict=True))
    for number, (cx, cy, r) in known.items():
        on = xy[line == number]
        off = float(np.abs(np.hypot(on[:, 0] - cx, on[:, 1] - cy) - r).max(initial=0.0))
        assert off < 0.0075, f"line {number}: {off:.4f} mm off its circle"
    return "arcs"


def check_profile(seed: int) -> str:
    """A mutated profile: an error, or a printer with which a file is converted or refused."""
    rng = Random(seed)
    text = mutations.profile(rng, list(shipped().values()))
    lines = (SAMPLES / "rectangle.gcode").read_bytes().splitlines(keepends=True)
    try:
        with bounded():
            printer = parse(text, "mutated")
            printer = replace(printer, name="mutated")
            for _ in GcodeConversion(
                iter(lines), printer, Options("racking", clamp=rng.random() < 0.5)
            ):
                pass
            played_by(printer, "klipper")
    except HframeError as error:
        check_error(error)
        return f"refused: {type(error).__name__}"
    return "converted"


def check_table(seed: int, tables: list[bytes], folder: Path) -> str:
    """A mutated recording or command file: an error, or something that is finite."""
    rng = Random(seed)
    path = folder / f"{seed}.csv"
    path.write_bytes(mutations.table(rng, rng.choice(tables)))
    try:
        with bounded():
            if rng.random() < 0.5:
                command_file.read(path)
            else:
                accelerometer.read(path)
    except HframeError as error:
        check_error(error)
        return f"refused: {type(error).__name__}"
    finally:
        path.unlink()
    return "read"
