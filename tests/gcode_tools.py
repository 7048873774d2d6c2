"""Sample files, their conversion, and a reader of written streams independent of the package."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from hframe_post.compensation.stops import stop_rules
from hframe_post.conversion.options import Options
from hframe_post.conversion.print_report import Report
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.planner.lookahead import plan
from hframe_post.planner.sampling import sample as sampled
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Samples
from hframe_post.writers.print_time import Deferred
from tests.conftest import ROOT, SAMPLES

WORD = re.compile(r"([XYZEFP])(-?\d*\.?\d+)")
VERSION = re.compile(rb"(?<=processed by hframe-post )[^,]+")

HEAD = ["G28", "G1 Z0.3 F600", "G0 X60 Y60 F9000", "M83"]
SPANS = b"G28\nG90\nM83\nG1 X140 Y100 Z0.2 F9000\n" + b"".join(
    b"G1 X260 Y%d E4\nG4 P250000\nG1 E-1 F2400\nG1 X140 E1\n" % y for y in (100, 120, 140)
)  # the pauses are long enough for a second process to start after each


@dataclass
class Reading:
    """What a stream does: the position after every G1, the filament at every layer, other lines."""

    points: list[tuple[float, float, float]] = field(default_factory=list)
    filament: float = 0.0
    at_layer: list[float] = field(default_factory=list)
    others: list[str] = field(default_factory=list)


def follow(text: bytes, layer: str = ";LAYER:", marlin: bool = False) -> Reading:
    """Follow moves to their ends with G90/G91, M82/M83 and G92 E, as Klipper does.

    layer: how a layer's mark begins, in any case. marlin: G90 and G91 are for E, too.
    """
    reading = Reading()
    at = {"X": 0.0, "Y": 0.0, "Z": 0.0, "E": 0.0}
    absolute = absolute_e = True
    for raw in text.decode("latin-1").splitlines():
        line = raw.split(";")[0].split("(")[0].strip()
        command = line.split()[0] if line else ""
        words = {letter: float(value) for letter, value in WORD.findall(line)}
        if command in ("G0", "G1", "G2", "G3", "G5"):
            for letter, value in words.items():
                if letter == "E":
                    counted = absolute_e and (absolute or marlin)
                    step = value - at["E"] if counted else value
                    reading.filament += step
                    at["E"] += step
                elif letter in "XYZ":
                    at[letter] = value if absolute else at[letter] + value
            reading.points.append((at["X"], at["Y"], at["Z"]))
            continue
        if command in ("G90", "G91"):
            absolute = command == "G90"
            absolute_e = absolute if marlin else absolute_e
        elif command in ("M82", "M83"):
            absolute_e = command == "M82"
        elif command == "G92" and "E" in words:
            at["E"] = words["E"]
        if re.match(layer, raw, re.IGNORECASE):
            reading.at_layer.append(reading.filament)
        reading.others.append(raw)
    return reading


def converted(
    lines: list[bytes], profile: Printer, options: Options | None = None
) -> tuple[bytes, Report]:
    conversion = WholeFile(iter(lines), profile, options or Options("racking"))
    pieces = [o.text if isinstance(o, Deferred) else o for o in conversion.gcode()]
    return b"".join(pieces), conversion.report


def planned(lines: Iterable[str], printer: Printer, strategy: str = "racking") -> list[Samples]:
    raw = (line.encode() + b"\n" for line in lines)
    items = read(raw, ReadOptions.from_printer(printer, "printer"))
    waits = stop_rules(printer.compensation.stops, strategy)
    return list(sampled(plan(items, printer.limits), printer.limits, waits))


def sample(name: str) -> list[bytes]:
    return (SAMPLES / name).read_bytes().splitlines(keepends=True)


def quirk(name: str) -> list[bytes]:
    return (ROOT / "tests" / "quirks" / f"{name}.gcode").read_bytes().splitlines(keepends=True)


def layers(name: str, last: int) -> list[bytes]:
    """Return the lines of a sample file up to the given layer."""
    lines = sample(name)
    return lines[: lines.index(b";LAYER:%d\n" % last)]


def sliced(count: int) -> list[bytes]:
    """Return the cube's first layers and the end of its file, for a bed of 200 mm."""
    lines, end = sample("cube.gcode"), b"M140 S0\n"  # begins what CuraEngine writes last
    whole = [*lines[: lines.index(b";LAYER:%d\n" % count)], *lines[lines.index(end) :]]
    return [line.replace(b"G1 X0 Y220", b"G1 X0 Y190") for line in whole]


def assert_same_stream(now: bytes, then: bytes, place: float = 0.002, feed: float = 1e-3) -> None:
    """Assert equality but for the version; 2 µm and 0.1 % of the feed rate: C libraries round."""
    versions = (VERSION.sub(b"", each, count=1) for each in (now, then))
    rows = list(zip(*(each.splitlines() for each in versions), strict=True))
    for a, b in rows:
        if not a.startswith(b"G1"):
            assert a == b
            continue
        words = [{w[:1]: float(w[1:]) for w in row.split()[1:]} for row in (a, b)]
        assert words[0].keys() == words[1].keys()
        for letter, value in words[0].items():
            scale = feed * value if letter == b"F" else place
            assert value == pytest.approx(words[1][letter], abs=scale), (a, b)


def strokes(seed: int, count: int, *lifts: float, between: Sequence[str] = ()) -> list[str]:
    """Return strokes of 10 to 30 mm in random directions, with retraction and travel between.

    The travel is at one of the lifts, mm, if there are any. between: lines before it.
    """
    rng, lines, here = np.random.default_rng(seed), list(HEAD), np.array([100.0, 100.0])
    for _ in range(count):
        angle, length = rng.uniform(0, 2 * np.pi), rng.uniform(10.0, 30.0)
        there = np.clip(here + length * np.array([np.cos(angle), np.sin(angle)]), 20, 250)
        here = np.clip(there + rng.uniform(-40.0, 40.0, 2), 20, 250)
        stroke = f"G1 X{there[0]:.3f} Y{there[1]:.3f} E{0.04 * length:.5f} F6000"
        lines += [stroke, "G1 E-1.6 F2400"]
        lines += [f"G1 Z{0.3 + rng.choice(lifts):g} F1200"] if lifts else []
        lines += [*between, f"G0 X{here[0]:.3f} Y{here[1]:.3f} F12000"]
        lines += [*(["G1 Z0.3 F1200"] if lifts else []), "G1 E1.6 F2400"]
    return lines


def hops(seed: int, count: int) -> list[bytes]:
    """Return strokes with lifts of many heights, and a line for a fan in each."""
    lines = strokes(seed, count, 0.05, 0.2, 0.4, 1.0, between=["M106 S99"])
    return [line.encode() + b"\n" for line in lines]


def one_by_one(*arguments: Any) -> int:
    """Take no lines, in place of ``native.plain_lines``: the reader takes each line."""
    arguments[-1][:] = 0
    return 0
