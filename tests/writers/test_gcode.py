"""The writer alone, fed with samples made up for it: what holds for every stream it writes."""

import re
from collections import Counter
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post.arrays import TS, Array, E
from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.firmware.code import Code
from hframe_post.firmware.motion import MotionRules
from hframe_post.firmware.registry import firmware as firmware_of
from hframe_post.prediction.predict import Played
from hframe_post.printer.profile import load
from hframe_post.stream.marks import Mark, Marks
from hframe_post.stream.types import (
    Dwell,
    Event,
    Handling,
    ModalState,
    MoveAtRest,
    Passthrough,
    Samples,
    frozen,
)
from hframe_post.writers.decimation import Units
from hframe_post.writers.gcode import GcodeWriter
from hframe_post.writers.page import NOTHING_BETWEEN, Between, Page
from hframe_post.writers.print_time import Deferred
from tests.gcode_tools import follow
from tests.mark_tools import mark
from tests.paths import smaller

STATE = ModalState(True, False, 0.0, 50.0, (0.0, 0.0, 0.0))
PROFILES = {"klipper": "paper", "marlin": "paper-marlin"}


Parts = tuple[MotionRules, Code]  # of a firmware on a printer


@cache
def parts_of(profile: str) -> Parts:
    printer = load(profile)
    own = firmware_of(printer)
    return own.motion(0.002), own.code()


@pytest.fixture
def klipper() -> Parts:
    return parts_of("paper")


def curve(n: int, start: Array, seed: int) -> Array:
    """x, y, z, e (n, 4) of smooth motion from a place, at rest at both ends."""
    rng = np.random.default_rng(seed)
    along = np.arange(1, n + 1) / n
    s = along - np.sin(2.0 * np.pi * along) / (2.0 * np.pi)
    heading = rng.uniform(-1.0, 1.0, 2) * min(0.05 * n, 40.0)
    bend = rng.uniform(-2.0, 2.0, 2)
    xy = start[:2] + np.outer(s, heading) + np.outer(np.sin(np.pi * s) ** 3, bend)
    z = np.full(n, start[2])
    return np.column_stack([xy, z, start[E] + s * rng.uniform(0.0, 2.0)])


def stream(parts: list[tuple[str, int]], seed: int = 0) -> Samples:
    """Samples of one stretch: ``move`` of n samples, ``mark`` at the k-th sample to come,
    ``retract`` by n hundredths, ``lift``, ``wait`` for n samples."""
    at = np.array([100.0, 100.0, 0.0, 0.0])
    rows, events = [at[None]], list[Event]()
    index = 1
    for number, (kind, n) in enumerate(parts):
        made = at[None][:0]
        if kind == "move":
            made = curve(n, at, seed + number)
        elif kind == "mark":
            events.append(mark(index, b"M106 S%d" % number))
        else:
            end = at + {"retract": [0, 0, 0, -n / 100.0], "lift": [0, 0, n / 100.0, 0]}.get(
                kind, np.zeros(4)
            )
            if kind == "wait":
                made = np.tile(at, (n, 1))
                action: MoveAtRest | Passthrough = Passthrough(
                    0, b"G4 P%d" % n, Handling.REST, STATE, n * TS
                )
                events.append(Dwell(index, n, action, n * TS))
            else:
                made = np.linspace(at, end, 41)[1:]
                action = MoveAtRest(0, tuple(at.tolist()), tuple(end.tolist()), 30.0)
                events.append(Dwell(index, 40, action, 0.0395))
        if len(made):
            rows.append(made)
            at, index = made[-1], index + len(made)
    xyze = np.concatenate(rows)
    commands = {"none": frozen(xyze[:, :2].copy())}
    line = np.zeros(len(xyze), dtype=np.int64)
    return Samples(0, frozen(xyze), line, tuple(events), commands, ends_stretch=True)


def text(chunks: list[Samples], firmware: Parts) -> tuple[bytes, GcodeWriter]:
    writer = GcodeWriter("none", *firmware)
    pieces = [o.text if isinstance(o, Deferred) else o for o in writer.write(chunks)]
    return b"".join(pieces), writer


PARTS = st.lists(
    st.one_of(
        st.tuples(st.just("move"), st.integers(100, 400)),
        st.tuples(st.sampled_from(["mark", "retract", "lift"]), st.integers(1, 200)),
        st.tuples(st.just("wait"), st.integers(0, 90)),
    ),
    max_size=12,
)


@settings(max_examples=40)
@given(PARTS)
@pytest.mark.parametrize("name", list(PROFILES))
def test_filament_and_height_of_samples(name: str, parts: list[tuple[str, int]]) -> None:
    whole = stream(parts)
    written, writer = text([whole], parts_of(PROFILES[name]))
    reading = follow(written)
    assert reading.filament == pytest.approx(whole.xyze[-1, E], abs=5e-4)
    assert writer.summary.filament == pytest.approx(reading.filament, abs=1e-9)
    assert writer.summary.lines == written.count(b"\n")
    if reading.points:
        assert reading.points[-1][2] == pytest.approx(whole.xyze[-1, 2], abs=6e-4)


@settings(max_examples=20)
@given(PARTS, st.sampled_from([50, 1000, 100_000]))
@pytest.mark.parametrize("name", list(PROFILES))
def test_what_is_judged_is_the_motion_of_the_lines(
    name: str, parts: list[tuple[str, int]], size: int
) -> None:
    whole, played = stream(parts), Played("none")
    writer = GcodeWriter("none", *parts_of(PROFILES[name]), played=played)
    pieces = writer.write(smaller([whole], size))
    written = b"".join([o.text if isinstance(o, Deferred) else o for o in pieces])
    motion = played.motion(whole).commands["none"]
    for x, y, *_ in follow(b"G1 X100 Y100\n" + written).points[1:]:  # where lines end
        assert np.hypot(*(motion - [x, y]).T).min() < 1e-3
    off = np.hypot(*(motion - whole.commands["none"]).T)
    assert off.max(initial=0.0) < {"klipper": 0.005, "marlin": 0.15}[name]  # whole steps


def test_filament_of_every_carried_line_is_exact(klipper: Parts) -> None:
    """Of a thousand lines between segments: filament before each is its sample's, rounded."""
    n = 5000
    whole = stream([("move", n)])
    at = np.unique(np.random.default_rng(1).integers(500, n - 500, 1000))
    marks = (Marks.from_lines(Mark(int(k), b";LAYER:%d" % k) for k in at),)
    marked = Samples(0, whole.xyze, whole.line, marks, whole.commands, ends_stretch=True)
    reading = follow(text([marked], klipper)[0])
    np.testing.assert_allclose(reading.at_layer, whole.xyze[at, E], atol=1.1e-5)


def test_nothing_moves_in_the_streams_modes_after_a_release(klipper: Parts) -> None:
    released = Passthrough(7, b"M600", Handling.RELEASE, STATE)
    moving, onward = stream([("move", 300)]), stream([("move", 300)], seed=9)
    end = len(moving)
    first = Samples(0, moving.xyze, moving.line, (Dwell(end, 0, released),), moving.commands, True)
    second = Samples(end, onward.xyze, onward.line, (), onward.commands, True)
    lines = text([first, second], klipper)[0].splitlines()
    row = lines.index(b"M600")
    assert any(line.startswith(b"SET_VELOCITY_LIMIT VELOCITY=300") for line in lines[row - 5 : row])
    assert lines[row + 1] == b"G4 P0"
    taken = next(k for k in range(row, len(lines)) if lines[k].startswith(b"SET_VELOCITY_LIMIT"))
    assert not any(line.startswith(b"G1") for line in lines[row:taken])
    moves = [line for line in lines[taken:] if line.startswith(b"G1")]
    assert re.match(rb"G1 X\S+ Y\S+.* F", moves[0])


def test_standstill_in_motion_becomes_time_of_the_next_segment_or_a_dwell(klipper: Parts) -> None:
    """Short ones join the next segment, longer ones are dwells; together they are all the time."""
    moving = curve(200, np.array([100.0, 100.0, 0.3, 0.0]), 3)
    for still in (10, 400):
        stood = np.tile(moving[-1], (still, 1))
        onward = curve(200, moving[-1], 4)
        xyze = np.concatenate([moving[:1], moving, stood, onward])
        whole = Samples(
            0, frozen(xyze), np.zeros(len(xyze), dtype=np.int64), (),
            {"none": frozen(xyze[:, :2].copy())}, True,
        )  # fmt: skip
        between = re.findall(rb"G1 .*\nG4 P([\d.]+)\nG1 ", text([whole], klipper)[0])
        waited = sum(map(float, between))
        assert waited == 0 if still == 10 else abs(waited - still) < 40


@given(st.lists(st.integers(0, 5000), min_size=1, unique=True), st.integers(1, 20))
def test_busiest_second_is_that_with_the_most_lines(due: list[int], at_once: int) -> None:
    """However many lines are counted at once, from the first millisecond of it to the last."""
    due, page = sorted(due), Page(Units())
    for first in range(0, len(due), at_once):
        samples = np.array(due[first : first + at_once])
        at = np.zeros((len(samples) + 1, 4), np.int64)
        page.add_motion(at, np.ones(len(samples), np.int64), samples, NOTHING_BETWEEN, [])
        page.text()
    lines = Counter(sample // 1000 for sample in due)
    assert page.busiest == max(lines.values()), "lines in a second"


SPELLINGS = {
    "G91": ["G91", "G 91", "g91", "(c) G91", "N 5 G91", "N5 G91", "G091", " G91 ; (d)"],
    "M82": ["M82", "M 82", "m082", "(c)M82", "N 6M82"],
}


@pytest.mark.parametrize(
    ("spelling", "profile"),
    [
        (text, ("paper", "paper-marlin")[k % 2])
        for texts in SPELLINGS.values()
        for k, text in enumerate(texts)
    ],
)
def test_reader_and_writer_read_modes_alike(profile: str, spelling: str) -> None:
    name = next(name for name, texts in SPELLINGS.items() if spelling in texts)
    lines = [
        b"G90\n", b"M83\n", b"G1 X50 Y50 Z1 F6000\n", b"G1 X60 E.5\n", spelling.encode() + b"\n",
        b"G1 X80 E.7\n" if name == "M82" else b"G1 X20 E.2\n", b"G90\n", b"M83\n",
        b"G1 X90 E.1\n",
    ]  # fmt: skip
    printer = load(profile)
    text = b"".join(
        piece for piece in WholeFile(lines, printer, Options("none")).gcode()
        if isinstance(piece, bytes)
    )  # fmt: skip
    written = text.splitlines()
    following = written[written.index(spelling.encode()) + 1 :][:2]
    assert (b"G90" if name == "G91" else b"M83") in following
    reading = follow(text.replace(spelling.encode(), name.encode()))
    assert reading.points[-1][0] == pytest.approx(90.0, abs=0.02)


def test_modes_are_restored_after_each_of_many_lines_without_copies_of_them() -> None:
    lines = [b"M83 %d" % k if k % 3 else b"M82 %d" % k for k in range(3000)]
    marks = Marks.from_lines(Mark(k, line) for k, line in enumerate(lines))
    between = Between.from_marks(marks, marks.at, lambda line: b"M83\n" * line.startswith(b"M82"))
    found = [between.text[begin:end] for _, begin, end in between.places.tolist()]
    assert found == [line + (b"\n" if k % 3 else b"\nM83\n") for k, line in enumerate(lines)]
    assert between.places[:, 0].tolist() == list(range(3000))
    assert len(between.text) == sum(map(len, found))
