"""The same bytes and figures however a stage's input is cut, in all stages at once."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from hframe_post import library
from hframe_post.conversion.options import Options
from hframe_post.gcode import batching
from hframe_post.planner import sampling
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Extruder, Printer
from tests.gcode_tools import converted, hops, layers, sample


def small_rectangle() -> list[bytes]:
    """Return the paper's rectangle at a tenth of its size: it has a tenth of the samples."""
    small = {b"X140": b"X20", b"X260": b"X32", b"Y100": b"Y10", b"Y120": b"Y12",
             b"E4": b"E0.4", b"E0.7": b"E0.07"}  # fmt: skip
    lines = sample("rectangle.gcode")
    words = [[small.get(word, word) for word in line.split()] for line in lines]
    return [b" ".join(line) + b"\n" for line in words]


CUBE = layers("cube.gcode", 1)
ADVANCES = [b"SET_PRESSURE_ADVANCE ADVANCE=0.09 SMOOTH_TIME=0.02\n", b"M900 K0.09\n"]


def held_back() -> Printer:
    """Return an H-bot that advances filament, and that is clamped near an edge."""
    printer = replace(load("example-hbot"), extruder=Extruder(0.05))
    travel = replace(printer.travel, x=(0.0, 300.0), y=(0.0, 300.0))
    motors = replace(printer.motors, belt_acceleration=6000.0, belt_velocity=400.0)
    return replace(printer, travel=travel, motors=motors)


def at_the_edge() -> list[bytes]:
    """Return a part of the cube with changes of the advance, and a frame along the bed's edge."""
    frame = [b"G1 X%d Y%d E8 F9000\n" % xy for xy in ((0, 0), (90, 0), (90, 60), (0, 60), (0, 0))]
    return [*CUBE[:80], *ADVANCES, *CUBE[80:120], *frame, b"G1 E-1 F2400\n"]


CASES: dict[str, tuple[list[bytes], Printer, list[tuple[int, int]]]] = {
    "rectangle": (small_rectangle(), load("paper"), [(1, 7), (100, 100)]),
    "cube": (CUBE, load("paper"), [(7, 1000)]),
    "held back": (at_the_edge(), held_back(), [(1, 77), (9, 800)]),
    "board": (hops(0, 2), load("paper-marlin"), [(1, 7), (5, 300)]),
}


def numbers(figures: Any) -> Iterator[float]:
    """Yield all numbers of a JSON, by the names of its keys."""
    if isinstance(figures, dict | list):
        ordered = sorted(figures.items()) if isinstance(figures, dict) else enumerate(figures)
        for _, each in ordered:
            yield from numbers(each)
    elif isinstance(figures, int | float):
        yield figures


@pytest.mark.parametrize("name", CASES)
def test_nothing_depends_on_how_the_stream_is_cut(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Commands, text and report, and what is simulated by layer and feature, on whole steps."""
    lines, printer, cuts = CASES[name]
    options = Options("racking", ("none", "racking"), force=True)

    def made() -> tuple[bytes, list[float], int]:
        text, report = converted(lines, printer, options)
        simulated = library.simulate(lines, printer, options, steps=printer.steps is not None)
        figures = [*numbers(report.as_json()), *numbers(simulated.as_json())]
        return text, figures, report.clamped.samples

    text, figures, clamped = made()
    assert bool(clamped) == (name == "held back")
    for moves, samples in cuts:
        monkeypatch.setattr(batching, "MOVES_PER_ITEM", moves)
        monkeypatch.setattr(sampling, "SAMPLES_PER_CHUNK", samples)
        cut, same, _ = made()
        assert cut == text
        assert same == pytest.approx(figures, rel=1e-6, abs=1e-9)
