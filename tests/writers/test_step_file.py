"""Step files: what is written is read back, and what is broken is refused with its line."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.arrays import Array, Integers
from hframe_post.errors import HframeError, StepFileError
from hframe_post.prediction.predict import judge
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Samples
from hframe_post.writers import step_file
from hframe_post.writers.files import compressing
from hframe_post.writers.step_file import (
    End,
    Header,
    Item,
    Note,
    Start,
    StepFileWriter,
    Stepped,
    inlined,
)
from tests.conftest import SAMPLES
from tests.step_tools import write_steps

MATRIX = np.array([[1.0, 1.0], [1.0, -1.0]])
RECTANGLE = (SAMPLES / "rectangle.gcode").read_bytes().splitlines(keepends=True)


def header(kind: str) -> Header:
    return Header(kind, "1.2", "mine, too", "abc", 40_000.0, (0.02, 0.02, 0.0025, 0.0024), MATRIX)


def text_of(items: list[Item], kind: str, inline: bool = False) -> tuple[bytes, StepFileWriter]:
    writer = StepFileWriter(header(kind))
    pieces = inlined(writer.write(items)) if inline else writer.write(items)
    return b"".join(p for p in pieces if isinstance(p, bytes)), writer


@st.composite
def steps(draw: st.DrawFn) -> list[Item]:
    """Two stretches of steps in pieces, each motor once a tick at most."""
    items: list[Item] = []
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    tick = 0
    for _ in range(2):
        items.append(Start(tick, tuple(rng.integers(-(10**6), 10**6, 4).tolist())))
        for _ in range(draw(st.integers(0, 3))):
            n = draw(st.integers(1, 80))
            pairs = np.unique(rng.integers(1, 4 * n, n))  # tick and motor in one
            ticks = tick + 1 + pairs // 4 * draw(st.sampled_from([1, 7, 10**6]))
            keys = ticks * 8 + pairs % 4 * 2 + rng.integers(0, 2, len(pairs))
            items.append(Stepped(keys, (Note(int(ticks[0]), "carried", b"M106 S3,4"),)))
            tick = int(ticks[-1])
    items.append(End(tick + 5))
    return items


def expected(items: list[Item]) -> tuple[list[int], list[list[int]]]:
    """Ticks and positions after each step, one by one."""
    ticks, positions, at = [], [], [0, 0, 0, 0]
    for item in items:
        if isinstance(item, Start):
            at = list(item.position)
            ticks.append(item.tick)
            positions.append(list(at))
        elif isinstance(item, Stepped):
            for key in item.keys.tolist():
                at[key // 2 % 4] += 1 if key % 2 else -1
                ticks.append(key // 8)
                positions.append(list(at))
    return ticks, positions


def last_of_ticks(tick: Integers, position: Integers) -> dict[int, list[int]]:
    return dict(zip(tick.tolist(), position.tolist(), strict=True))


@given(items=steps(), inline=st.booleans(), size=st.sampled_from([300, 1000, 1 << 20]))
@pytest.mark.parametrize("kind", ["steps", "step-bits"])
def test_positions_are_read_back(
    tmp_path_factory: pytest.TempPathFactory, kind: str, items: list[Item], inline: bool, size: int
) -> None:
    path = tmp_path_factory.mktemp("steps") / "a.csv"
    text, writer = text_of(items, kind, inline)
    path.write_bytes(text)
    assert writer.lines == text.count(b"\n") - text.count(b"#event,")
    with pytest.MonkeyPatch.context() as patch:
        file = step_file.read(path)
        patch.setattr(step_file, "BYTES_AT_ONCE", size)
        blocks = list(file)
    ticks, positions = expected(items)
    tick = np.concatenate([block.tick for block in blocks])
    position = np.concatenate([block.position for block in blocks])
    if kind == "steps":
        assert (tick.tolist(), position.tolist()) == (ticks, positions)
    assert last_of_ticks(tick, position) == dict(zip(ticks, positions, strict=True))
    assert len(tick) == writer.rows + sum(block.fresh for block in blocks)
    xyze = np.concatenate([block.xyze for block in blocks])
    mm = position * np.array([0.02, 0.02, 0.0025, 0.0024])
    np.testing.assert_allclose(xyze[:, :2] @ MATRIX.T, mm[:, :2], atol=1e-6)
    np.testing.assert_allclose(xyze[:, 2:], mm[:, 2:])


def test_header_is_read_back(tmp_path: Path) -> None:
    for kind in ("steps", "step-bits"):
        (tmp_path / "a.csv").write_bytes(text_of([End(0)], kind)[0])
        got = step_file.read(tmp_path / "a.csv").header
        assert got.text() == header(kind).text()
        assert (got.printer, got.settings, got.clock_hz) == ("mine, too", "abc", 40_000.0)


def test_masks_are_those_of_the_motors() -> None:
    keys = np.array([5 * 8 + 0 + 1, 5 * 8 + 4, 9 * 8 + 6 + 1, 12 * 8 + 0])  # A+ Z−, E+, A−
    text, writer = text_of([Start(0, (0, 0, 0, 0)), Stepped(keys), End(20)], "step-bits")
    assert text.splitlines()[-4:] == [b"5,5,1", b"9,8,9", b"12,1,8", b"#end,20,3"]
    assert writer.rows == 3


def test_inline_events_stand_after_the_steps_of_their_tick() -> None:
    keys = np.array([5 * 8, 5 * 8 + 2, 6 * 8])
    notes = (Note(0, "carried", b"a,b"), Note(5, "rest", b"G4 P1"))
    text, _ = text_of([Start(0, (0, 0, 0, 0)), Stepped(keys, notes), End(6)], "steps", True)
    assert text.splitlines()[-6:] == [
        b"#event,0,carried,a,b", b"5,A,0", b"5,B,0", b"#event,5,rest,G4 P1", b"6,A,0", b"#end,6,3",
    ]  # fmt: skip


# ---------------------------------------------------------------------- broken files


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("good") / "a.csv"
    write_steps(path, RECTANGLE, load("paper"))
    return path.read_bytes()


def edited(before: bytes, after: bytes) -> Callable[[bytes], bytes]:
    return lambda text: text.replace(before, after, 1)


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda text: b"", "line 1: this is not a step file"),
        (lambda text: b"G1 X3\n", "line 1: this is not a step file"),
        (lambda text: text[:-1], "incomplete"),
        (lambda text: text[: len(text) // 2], "incomplete"),
        (lambda text: text[: text.index(b"#end")], "incomplete"),
        (lambda text: text + b"99999999,A,1\n", "lines after the end"),
        (edited(b"steps,1", b"steps,2"), "version 2"),
        (edited(b"tick,motor", b"tick,engine"), "names of the columns"),
        (edited(b"0.0206,0.0206", b"0.0,0.0206"), "are invalid"),
        (edited(b"#belt,B,1,-1", b"#belt,B,1,1"), "are invalid"),
        (edited(b"59,A,1\n", b"59,C,0\n"), "line 12: this is not a row"),
        (edited(b"59,A,1\n", b"59,A,2\n"), "line 12: this is not a row"),
        (edited(b"59,A,1\n", b"3 1,A,1\n"), "line 12: this is not a row"),
        (edited(b"59,A,1\n", b"59;A,1\n"), "line 12: this is not a row"),
        (edited(b"59,A,1\n", b"\n"), "line 12: this is not a row"),
        (edited(b"59,A,1\n", b"B\n"), "line 12: this is not a row"),
        (edited(b"59,A,1\n", b"9" * 19 + b",A,1\n"), "line 12: this is not a row"),
        (edited(b"59,A,1\n", b"432,A,1\n"), "line 13: this is not a row"),
        (edited(b"59,A,1\n", b""), "were written"),
        (edited(b"59,A,1\n", b"#stop\n"), "line 12: unknown kind of line"),
        (edited(b"#start,0,11650", b"#event,0,11650"), "line 12: steps from an unknown position"),
        (edited(b"#start,0,", b"#start,x,"), "line 11: unknown kind of line"),
        (edited(b"59,A,1\n", b"59,A,1\n#start,5,0,0,0,0\n"), "line 13: ticks go backwards"),
    ],
)  # fmt: skip
def test_broken_file_is_refused(
    tmp_path: Path, good: bytes, change: Callable[[bytes], bytes], cause: str
) -> None:
    path = tmp_path / "b.csv"
    path.write_bytes(change(good))
    with pytest.raises(StepFileError, match=cause) as caught:
        for _ in step_file.read(path):
            pass
    assert str(path) in str(caught.value)


def test_ticks_of_the_other_kind_rise_strictly(tmp_path: Path, good: bytes) -> None:
    text, _ = text_of([Start(0, (0,) * 4), Stepped(np.array([8, 16])), End(2)], "step-bits")
    (tmp_path / "b.csv").write_bytes(text.replace(b"2,1,0\n", b"1,1,0\n"))
    with pytest.raises(StepFileError, match="goes backwards"):
        list(step_file.read(tmp_path / "b.csv"))


def test_missing_file_is_the_systems_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        step_file.read(tmp_path / "none.csv")


def test_packed_files_are_unpacked_and_truncated_ones_refused(tmp_path: Path, good: bytes) -> None:
    path = tmp_path / "a.csv.gz"
    with path.open("wb") as file, compressing(file, ".gz") as packed:
        packed.write(good)
    (tmp_path / "a.csv").write_bytes(good)
    a, b = (list(step_file.read(p)) for p in (path, tmp_path / "a.csv"))
    assert len(a) == len(b)
    for one, other in zip(a, b, strict=True):
        np.testing.assert_array_equal(one.xyze, other.xyze)
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(StepFileError):
        list(step_file.read(path))


def test_packing_is_the_same_every_time_and_for_others_to_unpack(
    tmp_path: Path, good: bytes
) -> None:
    files = [tmp_path / f"{name}.gz" for name in "ab"]
    for path in files:
        with path.open("wb") as file, compressing(file, ".gz") as packed:
            packed.write(good[:1000])
            packed.write(good[1000:])
    assert files[0].read_bytes() == files[1].read_bytes()
    assert gzip.decompress((tmp_path / "a.gz").read_bytes()) == good


def test_zst_is_refused_with_the_command_that_unpacks_it(tmp_path: Path) -> None:
    (tmp_path / "a.csv.zst").write_bytes(b"")
    with pytest.raises(HframeError, match="unpack it with 'zstd -d "):
        step_file.read(tmp_path / "a.csv.zst")


# ---------------------------------------------------------------------- file → positions → plant


def at_milliseconds(path: Path, samples: int) -> Array:
    """x and y at the end of every millisecond, as the motors hold them between their steps."""
    file = step_file.read(path)
    blocks = list(file)
    tick = np.concatenate([block.tick for block in blocks])
    xy = np.concatenate([block.xyze[:, :2] for block in blocks])
    now = np.arange(1, samples + 1) * file.header.clock_hz / 1000.0
    return xy[np.searchsorted(tick, now, side="right") - 1]


@pytest.mark.parametrize("kind", ["steps", "step-bits"])
@pytest.mark.parametrize("strategy", ["racking", "none"])
def test_plant_driven_by_the_steps_prints_what_was_predicted(
    tmp_path: Path, paper: Printer, commands: Callable[[str], Samples], kind: str, strategy: str
) -> None:
    """G-code → CSV → positions → plant → contour error, beside that of the samples."""
    report = write_steps(tmp_path / "r.csv", RECTANGLE, paper, kind, strategy)
    whole = commands(strategy)
    stepped = at_milliseconds(tmp_path / "r.csv", len(whole))
    exact = whole.commands[strategy]
    half = np.abs((stepped - exact) @ MATRIX.T).max()
    fastest = np.abs(np.diff(exact @ MATRIX.T, axis=0)).max() / 40
    assert half <= 0.0206 / 2 + fastest + 1e-3
    both = {"samples": exact, "steps": stepped}
    played = replace(whole, commands=both)
    (judged,) = judge([played], paper.plant)
    rms = {name: float(np.sqrt((e**2).mean())) for name, e in judged.contour.items()}
    rounding = 0.0206 / np.sqrt(12.0)  # of x and y together: (A ± B)/2, each step/√12
    assert 0.95 * rms["samples"] <= rms["steps"] <= 1.001 * np.hypot(rms["samples"], rounding)
    assert report.steps is not None
    assert report.steps.rows > 20_000
