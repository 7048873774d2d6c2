"""Steps of the motors: none lost, none too early, none two at once."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from hframe_post.arrays import Array
from hframe_post.errors import LimitError
from hframe_post.printer.settings import Steps
from hframe_post.stream.types import Dwell, Event, Handling
from hframe_post.writers import steps
from tests.mark_tools import mark
from tests.step_tools import Stepping, block, line, stepped

TABLE = Steps(belt=0.02, z=0.0025, e=0.0024, clock_hz=40_000.0)
LENGTHS = np.array([0.02, 0.02, 0.0025, 0.0024])
PER_SAMPLE = 40


def at_rest_around(path: Array) -> Array:
    return np.concatenate([path[:1], path, path[-1:], path[-1:]])


@st.composite
def paths(draw: st.DrawFn) -> Array:
    """x, y, z, e at up to 60 samples, within 30 steps a sample and at rest at both ends."""
    n, rng = draw(st.integers(1, 60)), np.random.default_rng(draw(st.integers(0, 10**6)))
    rate = rng.uniform(-1.0, 1.0, (n, 4)) * draw(st.sampled_from([0.3, 3.0, 30.0]))
    rate = np.where(rng.random((n, 4)) < 0.3, rng.choice([0.0, 0.5, -0.5, 30.0], (n, 4)), rate)
    start = rng.choice([0.0, 1.0, 100.01, -7.0], 4) + draw(st.sampled_from([0.0, 0.123456]))
    return at_rest_around(start + np.cumsum(rate * LENGTHS, axis=0))


def rounded(path: Array) -> Array:
    """Whole steps nearest to the path, which counts to a millionth of a µm."""
    return np.asarray(np.floor(np.round(path, 9) / LENGTHS + 0.5))


@settings(max_examples=80)
@given(paths())
def test_steps_are_the_variation_of_the_rounded_path(path: Array) -> None:
    done, at = stepped([block(path)], TABLE), rounded(path)
    assert done.starts[0].position == tuple(at[0])
    variation = np.abs(np.diff(at, axis=0)).sum(axis=0)
    for motor in range(4):
        ticks, ways = done.of(motor)
        assert len(ticks) == variation[motor] == done.counts.steps[motor]
        assert ways.sum() == at[-1, motor] - at[0, motor] == done.counts.net[motor]
        assert (np.diff(ticks) > 0).all()
    assert (np.diff(done.rows[:, 0]) >= 0).all()
    assert done.counts.ticks == PER_SAMPLE * len(path)
    pause = Dwell(len(path) - 2, 0, line(b"M117", Handling.REST))  # as soon as it is there
    paused = stepped([block(path[:-2], 0, (pause,))], TABLE)
    np.testing.assert_array_equal(paused.rows, done.rows)


def spline(u: Array) -> CubicHermiteSpline:
    """The monotone cubic, with tangents written out one by one."""
    m = []
    for before, here, after in zip(u, u[1:], u[2:], strict=False):
        left, right = here - before, after - here
        mean, most = (left + right) / 2.0, 3.0 * min(abs(left), abs(right))
        m.append(float(np.clip(mean, -most, most)) if left * right > 0.0 else 0.0)
    return CubicHermiteSpline(np.arange(len(m)), u[1:-1], m)


def position_after_each_tick(done: Stepping, motor: int, ticks: int) -> Array:
    moved = np.zeros(ticks + 1)
    when, ways = done.of(motor)
    np.add.at(moved, when, ways)
    return done.starts[0].position[motor] + np.cumsum(moved)


@settings(max_examples=40)
@given(paths())
def test_position_is_within_half_a_step_and_a_tick_of_the_command(path: Array) -> None:
    done, ticks = stepped([block(path)], TABLE), PER_SAMPLE * len(path)
    for motor, length in enumerate(LENGTHS):
        command = spline(np.pad(np.concatenate([path[:1], path])[:, motor] / length, 1, "edge"))
        tick = np.arange(ticks + 1)
        off = np.abs(position_after_each_tick(done, motor, ticks) - command(tick / PER_SAMPLE))
        fine = np.abs(command(np.arange(ticks * 4 + 1) / (4 * PER_SAMPLE), 1)) / PER_SAMPLE
        motion = np.array([fine[max(4 * k - 4, 0) : 4 * k + 1].max() for k in tick])
        # where the command wants more than a step a tick, steps wait for one another
        queued = 2.0 if fine.max() > 0.9 else 0.0
        assert (off <= 0.5 + 1.05 * motion + 0.01 + queued).all()
        assert off[-1] <= 0.5 + 1e-6


@pytest.mark.parametrize("motor", range(4))
def test_command_faster_than_the_clock_is_an_error_with_its_line(motor: int) -> None:
    path = np.zeros((30, 4))
    path[10:, motor] = np.arange(20) * LENGTHS[motor] * PER_SAMPLE * 1.01
    with pytest.raises(LimitError, match=f"line 12: speed of motor {'ABZE'[motor]}") as caught:
        stepped([block(path)], TABLE)
    assert caught.value.bound == pytest.approx(LENGTHS[motor] * TABLE.clock_hz)


def swinging(samples: int = 400) -> Array:
    t = np.arange(samples)
    path = np.zeros((samples, 4))
    path[:, 0], path[:, 3] = 5.0 * np.sin(t / 20.0), 0.01 * np.sin(t / 3.0)
    return at_rest_around(path)


@pytest.mark.parametrize("setup", [0.0, 60e-6, 1e-3])
def test_turning_motor_waits_for_its_direction_either_way(setup: float) -> None:
    at_once = stepped([block(swinging())], TABLE)
    table = Steps(0.02, 0.0025, 0.0024, 40_000.0, setup)
    done = stepped([block(swinging())], table)
    for motor in (0, 3):
        ticks, ways = done.of(motor)
        assert ways.tolist() == at_once.of(motor)[1].tolist()  # order and count
        assert (ticks >= at_once.of(motor)[0]).all()
        for before, after in ((1, -1), (-1, 1)):
            turns = np.flatnonzero((ways[:-1] == before) & (ways[1:] == after))
            assert len(turns)
            gap = ticks[turns + 1] - ticks[turns]
            assert (gap >= max(math.ceil(setup * 40_000.0), 1)).all()


def test_noise_on_a_half_step_does_not_make_a_motor_tremble() -> None:
    rng = np.random.default_rng(0)
    path = np.zeros((1000, 4))
    path[:, 0] = 10.01 + rng.normal(size=1000) * 1e-13  # between steps 500 and 501
    assert stepped([block(path)], TABLE).counts.steps[0] == 0


def moving(start: float, stop: float, n: int) -> Array:
    path = np.zeros((n, 4))
    path[:, 0] = np.linspace(start, stop, n)
    return path


def test_waiting_passes_as_time_and_lines_at_rest_part_the_steps() -> None:
    there, back = at_rest_around(moving(0, 5, 50)), at_rest_around(moving(5, 0, 50))
    path = np.concatenate([there, np.tile(there[-1], (20, 1)), back])
    wait = Dwell(len(there), 20, line(b"G4 P20", Handling.REST, 0.02), 0.02)
    done = stepped([block(path, events=(wait,))], TABLE)
    (note,) = done.notes
    assert (note.tick, note.handling, note.text) == (len(there) * PER_SAMPLE, "rest", b"G4 P20")
    ticks, ways = done.of(0)
    assert (ways[ticks <= note.tick] == 1).all()
    assert (ways[ticks > note.tick] == -1).all()
    assert not ((ticks > note.tick) & (ticks <= note.tick + 20 * PER_SAMPLE)).any()
    assert done.counts.ticks == len(path) * PER_SAMPLE


def test_step_that_is_late_still_comes_before_a_line_at_rest() -> None:
    """The last step turns and must wait; the line waits for it."""
    path = np.zeros((6, 4))
    path[1:, 0] = [0.3, 0.6, 0.59, 0.585, 0.585]
    table = Steps(0.02, 0.0025, 0.0024, 40_000.0, 1.5e-3)
    wait = Dwell(6, 0, line(b"M400", Handling.REST))
    after = block(path[::-1].copy(), 6)
    done = stepped([block(path, events=(wait,)), after], table)
    at = done.notes[0].tick
    ticks, ways = done.of(0)
    up_to = int(np.abs(np.diff(np.floor(np.round(path[:, 0], 9) / 0.02 + 0.5))).sum())
    assert (ticks <= at).sum() == up_to
    assert len(ways) > up_to


def test_after_a_yield_the_motors_may_stand_elsewhere() -> None:
    first, second = at_rest_around(moving(0, 5, 50)), at_rest_around(moving(100, 90, 50))
    home = Dwell(len(first), 0, line(b"G28", Handling.RELEASE))
    end = Dwell(len(first) + len(second), 0, line(b"", Handling.RELEASE))
    blocks = [block(first, events=(home,)), block(second, len(first), (mark(60, b";a"), end))]
    done = stepped(blocks, TABLE)
    assert [start.position[0] for start in done.starts] == [0, 5000]
    assert [start.tick for start in done.starts] == [0, len(first) * PER_SAMPLE]
    assert [(n.tick, n.handling) for n in done.notes] == [
        (len(first) * PER_SAMPLE, "yielded"), (60 * PER_SAMPLE, "carried"),
        (done.counts.ticks, "end"),
    ]  # fmt: skip
    assert done.counts.net[0] == 250 - 500


@pytest.mark.parametrize("size", [1, 2, 3, 7, 100])
def test_cuts_change_no_step(size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    path, table = swinging(300), Steps(0.02, 0.0025, 0.0024, 40_000.0, 5e-3)  # turns wait
    marks = tuple(mark(k, b"%d" % k) for k in range(0, 300, 7))
    wait = Dwell(150, 0, line(b"M400", Handling.REST))
    events: tuple[Event, ...] = tuple(sorted([*marks, wait], key=lambda event: event.index))
    whole = stepped([block(path, events=events)], table)
    monkeypatch.setattr(steps, "SAMPLES_AT_ONCE", size)
    pieces = [
        block(path[k : k + size], k, tuple(e for e in events if k <= e.index < k + size))
        for k in range(0, len(path), size)
    ]
    cut = stepped(pieces, table)
    np.testing.assert_array_equal(cut.rows, whole.rows)
    assert cut.notes == whole.notes
    assert cut.starts == whole.starts
