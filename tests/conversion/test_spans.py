"""Spans are cut by the input alone; bytes do not depend on jobs; nothing is lost between them."""

import os
import pickle
import signal
from collections.abc import Iterator
from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hframe_post import library
from hframe_post.conversion import spans
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Beginning, Chain
from hframe_post.conversion.spans import Span, Spans
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.errors import GcodeError, HframeError, LimitError
from hframe_post.gcode import batching
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.planner import sampling
from hframe_post.planner.lookahead import plan
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Extruder, Printer
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import MoveAtRest, Plan, Planned, SpanEnd
from hframe_post.writers.print_time import Deferred
from tests import gcode_tools
from tests.conftest import few
from tests.gcode_tools import follow, hops, layers, sample

OPTIONS = Options("racking", ("none", "racking"))


def converted(lines: list[bytes], printer: Printer, jobs: int) -> tuple[bytes, WholeFile]:
    conversion = WholeFile(iter(lines), printer, replace(OPTIONS, jobs=jobs))
    pieces = [with_elapsed(o) if isinstance(o, Deferred) else o for o in conversion.gcode()]
    return b"".join(pieces), conversion


def with_elapsed(deferred: Deferred) -> bytes:
    """The text with the elapsed time behind each line that tells of time."""
    text = deferred.text
    for (_, end), elapsed in reversed([*zip(deferred.at, deferred.elapsed, strict=True)]):
        text = text[:end] + b" %.6f" % elapsed + text[end:]
    return text


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Spans of a few seconds: many in a short file."""
    monkeypatch.setattr(spans, "SPAN_S", 4.0)


def planned(lines: list[bytes], printer: Printer) -> list[Planned]:
    return list(plan(read(iter(lines), ReadOptions.from_printer(printer)), printer.limits))


@pytest.mark.usefixtures("short")
def test_spans_hold_all_items_and_begin_where_the_machine_stands(paper: Printer) -> None:
    items = planned(layers("cube.gcode", 3), paper)
    cut = [(span.beginning, list(span.items)) for span in Spans(items)]
    assert len(cut) > 5
    assert [part.pop() for _, part in cut[:-1]] == [SpanEnd()] * (len(cut) - 1)
    assert [id(item) for _, part in cut for item in part] == [id(item) for item in items]
    assert cut[0][0].place is None
    for beginning, part in cut[1:]:
        assert isinstance(part[0], MoveAtRest)
        assert beginning.place == part[0].start


def test_a_worker_gets_all_that_a_span_has(paper: Printer) -> None:
    """Its plans are pickled together, and each is as it was."""
    items = planned(layers("cube.gcode", 1), paper)
    lift = next(item for item in items if isinstance(item, MoveAtRest))
    items = [replace(o, standing=((1, lift),)) if isinstance(o, Plan) else o for o in items]
    again = pickle.loads(pickle.dumps(Span(Beginning(), tuple(items)))).items
    for one, other in zip(items, again, strict=True):
        assert type(one) is type(other)
        for each in fields(one):
            same, found = getattr(one, each.name), getattr(other, each.name)
            if isinstance(same, Marks):
                assert [*same] == [*found]
            else:
                np.testing.assert_equal(found, same, each.name)


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("profile", few(["paper", "paper-marlin"], 1))
def test_processes_change_no_byte_and_figure(profile: str, monkeypatch: pytest.MonkeyPatch) -> None:
    printer, lines = load(profile), layers("cube.gcode", 2)
    text, conversion = converted(lines, printer, 1)
    other, again = converted(lines, printer, 3)
    assert other == text
    assert again.report.as_json() == conversion.report.as_json()
    monkeypatch.setattr(spans, "MAX_ITEMS", 30)  # some are too long for a worker
    assert converted(lines, printer, 2)[0] == text


@pytest.mark.usefixtures("short")
def test_nothing_is_lost_between_spans(paper: Printer) -> None:
    lines = [
        line for line in layers("cube.gcode", 3) if not line.startswith(b";MESH:")
    ]  # which release it
    text, conversion = converted(lines, paper, 1)
    before, after = follow(b"".join(lines)), follow(text)
    np.testing.assert_allclose(np.diff(after.at_layer), np.diff(before.at_layer), atol=1e-4)
    assert conversion.report.filament_after == pytest.approx(before.filament, abs=1e-5)
    assert after.filament == pytest.approx(before.filament, abs=1e-5)
    times = [line for line in text.splitlines() if line.startswith(b";TIME_ELAPSED:")]
    elapsed = [float(line.split()[-1]) for line in times]
    assert all(a < b for a, b in pairwise(elapsed))
    assert elapsed[-1] <= conversion.times[1]
    assert text.count(b"SET_VELOCITY_LIMIT VELOCITY=770") == 1  # the stream goes on


@pytest.mark.usefixtures("short")
def test_cuts_hardly_lengthen_a_print(paper: Printer, monkeypatch: pytest.MonkeyPatch) -> None:
    lines, cuts = (
        layers("cube.gcode", 3),
        len(list(Spans(planned(layers("cube.gcode", 3), paper)))) - 1,
    )
    cut = converted(lines, paper, 1)[1].times[1]
    monkeypatch.setattr(spans, "SPAN_S", 1e9)
    assert 0.0 <= cut - converted(lines, paper, 1)[1].times[1] <= 0.17 * cuts


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("jobs", [1, 3])
def test_the_first_error_in_the_file_is_raised(paper: Printer, jobs: int) -> None:
    """Reading runs ahead of computing, but its errors do not."""
    lines = layers("cube.gcode", 3)
    middle = lines.index(b";LAYER:1\n")
    outside = [*lines[:middle], b"G1 X500 F6000\n", *lines[middle:], b"G5 X1\n"]
    with pytest.raises(LimitError, match=f"line {middle + 1}:"):
        converted(outside, paper, jobs)
    with pytest.raises(GcodeError):
        converted([*lines, b"G93\n"], paper, jobs)


@pytest.mark.usefixtures("short")
def test_a_killed_worker_is_an_error(paper: Printer, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(chain: Chain, span: Span) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    monkeypatch.setattr(spans, "streamed", killed)
    with pytest.raises(HframeError, match="jobs 1"):
        converted(layers("cube.gcode", 3), paper, 2)


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
        text, report = gcode_tools.converted(lines, printer, options)
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
