"""No command leaves the bed or outruns a motor; a clamp reduces compensation smoothly."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hframe_post.arrays import TS, Array
from hframe_post.compensation import guard as guard_module
from hframe_post.compensation.clamp import AROUND, REACHES, Clamp, Clamped
from hframe_post.compensation.guard import (
    Guard,
    Peaks,
    check_deviation,
    check_prediction,
    max_deviation,
)
from hframe_post.errors import HframeError, LimitError
from hframe_post.library import convert
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Motors, Printer, Travel
from hframe_post.stream.chunks import batches, join, part
from hframe_post.stream.types import Dwell, Handling, ModalState, Passthrough, Samples
from tests.conftest import ROOT
from tests.paths import walk
from tests.quantities import below

TRAVEL, MOTORS = Travel((0.0, 200.0), (0.0, 150.0)), Motors(100.0, 2000.0)
LIMITS = (TRAVEL, MOTORS, Kinematics("cartesian"))
REACH = 2 * REACHES[0]  # samples in which a reduction fades in and out
FAR = (TRAVEL, Motors(1e5, 1e8), Kinematics())
thorough = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
seeds = st.integers(0, 2**32 - 1)


def chunk(path: Array, command: Array, first: int = 0, ends: bool = False) -> Samples:
    """Return samples whose source lines are counted from 1000."""
    xyze = np.column_stack([path, np.zeros((len(path), 2))])
    line = 1000 + first + np.arange(len(path))
    return Samples(first, xyze, line, (), {"racking": command}, ends)


def standing(n: int, x: float = 100.0, y: float = 50.0) -> Array:
    return np.tile([x, y], (n, 1))


def bump(n: int, at: int, height: float, width: int) -> Array:
    """Return a smooth deviation (n,) around a sample."""
    share = np.clip((np.arange(n) - at) / width, -1.0, 1.0)
    return height * (0.5 + 0.5 * np.cos(np.pi * share)) ** 2


def bumped(path: Array, axis: int, height: float, width: int, at: int = 400) -> Array:
    """Return the path with a bump of x or y."""
    command = path.copy()
    command[:, axis] += bump(len(path), at, height, width)
    return command


def checked(chunks: Iterable[Samples], limits: tuple[Travel, Motors, Kinematics]) -> Guard:
    guard = Guard(*limits)
    for _ in guard.check(chunks, "racking"):
        pass
    return guard


# ---------------------------------------------------------------------- the model's reach


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_command_farther_off_than_any_lag_is_refused(paper: Printer, share: float) -> None:
    most = max_deviation(paper.plant, paper.limits)
    command = standing(50)
    command[30] += share * most * np.array([0.6, -0.8])
    chunks = check_deviation([chunk(standing(50), command)], "racking", paper.plant, paper.limits)
    if share < 1.0:
        assert len(list(chunks)) == 1
    else:
        with pytest.raises(HframeError, match=rf"line 1030: .* {share * most:.1f} mm off its path"):
            list(chunks)


def test_a_model_that_predicts_what_no_working_printer_does_is_refused() -> None:
    check_prediction(0.99)
    with pytest.raises(HframeError, match=r"predicts 1\.2 mm RMS"):
        check_prediction(1.2)


# ---------------------------------------------------------------------- guard


@pytest.mark.parametrize(
    ("axis", "place", "message"),
    [
        (0, -0.01, r"x \(mm\) would be -0\.01, the printer's limit is 0"),
        (0, 200.01, r"x \(mm\) would be 200\.01, the printer's limit is 200"),
        (1, -0.01, r"y \(mm\) would be -0\.01"),
        (1, 150.01, r"y \(mm\) would be 150\.01"),
    ],
)
def test_bed_is_not_left(axis: int, place: float, message: str) -> None:
    command = standing(50)
    command[30, axis] = place
    with pytest.raises(LimitError, match=rf"line 1030: {message}"):
        checked([chunk(standing(50), command)], FAR)


def test_z_may_be_anywhere_from_its_lower_bound_to_its_upper() -> None:
    travel = replace(TRAVEL, z=(0.0, 180.0))
    at = chunk(standing(50), standing(50))
    for z in (0.0, 180.0):
        at.xyze.setflags(write=True)
        at.xyze[30, 2] = z
        checked([at], (travel, *FAR[1:]))
    for z, bound in ((-0.01, 0.0), (180.01, 180.0)):
        at.xyze[30, 2] = z
        with pytest.raises(LimitError, match=r"line 1030: z \(mm\)") as caught:
            checked([at], (travel, *FAR[1:]))
        assert caught.value.bound == bound


def test_motors_are_driven_up_to_their_limits_and_no_further() -> None:
    """x at 2000 mm/s² up to 100 mm/s, from rest."""
    command = standing(100)
    command[:, 0] += np.cumsum(np.minimum(np.arange(100) * 2.0, 100.0)) * TS
    peaks = checked([chunk(command, command)], LIMITS).peaks
    assert peaks.belt_velocity == pytest.approx(100.0)
    assert peaks.belt_acceleration == pytest.approx(2000.0)
    assert peaks.axis_acceleration == pytest.approx((2000.0, 0.0))
    harder = standing(100)
    harder[:, 0] += np.cumsum(np.minimum(np.arange(100) * 2.001, 50.0)) * TS
    with pytest.raises(LimitError, match=r"belt acceleration \(mm/s²\) would be 2001"):
        checked([chunk(harder, harder)], LIMITS)


def test_a_jump_is_seen_across_chunks_but_not_where_the_machine_may_have_moved() -> None:
    here, there = standing(20), standing(20, 120.0)
    apart = [chunk(here, here, ends=True), chunk(there, there, 20)]
    assert checked(apart, LIMITS).peaks.belt_velocity == 0.0
    with pytest.raises(LimitError, match="line 1020: belt velocity"):
        checked([chunk(here, here), chunk(there, there, 20)], LIMITS)


@thorough
@given(seeds, st.sampled_from([np.nan, np.inf, 0.01, 5.0, 300.0]), st.booleans())
def test_a_glance_is_as_good_as_a_look(paper: Printer, seed: int, odd: float, in_z: bool) -> None:
    """Safe or not, the same is known of the command, and the same said of it."""
    rng = np.random.default_rng(seed)
    path = np.tile([150.0, 80.0, 0.2, 0.0], (300, 1))
    path[:, :2] += walk(rng, 300)
    command = path[:, :2] + rng.normal(0.0, 1e-3, (300, 2))
    (path[:, 2:] if in_z else command)[rng.integers(0, 300), 0] += odd
    whole = Samples(0, path, np.arange(300), (), {"racking": command})

    def outcome() -> str | Peaks:
        try:
            limits = paper.travel, paper.motors, paper.kinematics
            return checked(batches([whole], 77), limits).peaks
        except HframeError as error:
            return str(error)

    at_a_glance = outcome()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(guard_module, "peaks_if_safe", lambda *_: None)
        assert outcome() == at_a_glance


# ---------------------------------------------------------------------- clamp


@thorough
@given(seeds, st.floats(3.5, 5.5))
def test_what_needs_no_reduction_passes_as_it_is(paper: Printer, seed: int, power: float) -> None:
    rng = np.random.default_rng(seed)
    path = np.array([150.0, 100.0]) + 0.05 * walk(rng, 2000)
    off = np.zeros((2000, 2))
    off[rng.integers(0, 2000, 3)] = 10.0**power * TS**2 * rng.uniform(0.1, 1.0, (3, 2))
    whole = chunk(path, path + off)

    def limited() -> tuple[bytes, Clamped]:
        guard = Guard(paper.travel, paper.motors, paper.kinematics, clamp=True)
        chunks = [*guard.check(batches([whole], 777), "racking")]
        return join(chunks).commands["racking"].tobytes(), guard.clamped

    at_a_glance = limited()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(guard_module, "peaks_if_safe", lambda *_: None)
        assert limited() == at_a_glance


def clamped(whole: Samples, limits: tuple[Travel, Motors, Kinematics]) -> tuple[Array, Clamp]:
    clamp = Clamp(*limits)
    return clamp.limited(whole, whole, "racking").commands["racking"], clamp


@pytest.mark.parametrize("height", [0.2, 1.0, 5.0])
def test_a_clamp_moves_a_command_smoothly_onto_the_bed(height: float) -> None:
    path = standing(800, x=0.1)
    command = bumped(path, 0, -height, 150)
    result, clamp = clamped(chunk(path, command), FAR)
    changed = np.flatnonzero((result != command).any(axis=1))
    assert result[:, 0].min() >= 0.0
    assert result[:, 0].min() == pytest.approx(0.0, abs=1e-9), "mm: no more is removed than must be"
    assert clamp.clamped.samples == len(changed)
    assert clamp.clamped.line == 1000 + changed[0]
    beyond = np.flatnonzero(command[:, 0] < 0.0)
    assert changed[0] >= beyond[0] - REACH
    assert changed[-1] <= beyond[-1] + REACH
    assert np.abs(np.diff(result - command, axis=0)).max() < 4.0 * height / REACH
    np.testing.assert_array_equal(result[:, 1], 50.0)


@pytest.mark.parametrize("width", [10, 20, 30])
def test_a_clamp_reduces_compensation_until_the_motors_can_follow(width: int) -> None:
    path = standing(800)
    command = bumped(path, 1, 0.3, width)
    with pytest.raises(LimitError):
        checked([chunk(path, command)], LIMITS)
    result, clamp = clamped(chunk(path, command), LIMITS)
    peaks = checked([chunk(path, result)], LIMITS).peaks
    assert peaks.belt_velocity <= MOTORS.belt_velocity
    assert peaks.belt_acceleration <= MOTORS.belt_acceleration
    assert 0 < clamp.clamped.samples <= 2 * (width + REACH) + 1
    assert np.abs(result - path).max() > 0.0  # not all of it


def test_a_clamp_leaves_what_the_motors_have_to_spare_on_a_moving_path() -> None:
    path = standing(800, x=20.0)
    path[:, 0] += 80.0 * TS * np.arange(800)  # 80 of 100 mm/s
    command = bumped(path, 0, 6.0, 300)
    asked = float(np.diff(command[:, 0]).max()) / TS
    result, clamp = clamped(chunk(path, command), LIMITS)
    reached = float(np.diff(result[:, 0]).max()) / TS
    assert clamp.clamped.samples > 0
    assert 80.0 < reached <= 100.0 < asked, "mm/s"
    assert (result - path).max() > 0.3, "mm: with the path's own speed misjudged, 0.2"


@pytest.mark.parametrize("height", [2.0, 3.0, 4.0])
def test_a_clamp_that_the_belts_cannot_follow_is_spread_over_more_time(height: float) -> None:
    path = standing(1200, x=0.1)
    command = bumped(path, 0, -height, 20, at=600)
    result, clamp = clamped(chunk(path, command), LIMITS)
    checked([chunk(path, result)], LIMITS)
    assert clamp.clamped.most == pytest.approx(np.abs(result - command).max())
    untouched = np.abs(np.arange(1200) - 600) > 20 + AROUND
    np.testing.assert_array_equal(result[untouched], command[untouched])


def corner(n: int, at: int, speed: float) -> Array:
    """Return a path (n, 2) from rest along x to x = 100, where it turns into y at a sample."""
    rate = speed * np.interp(np.arange(n), [0, 100, n - 100, n - 1], [0.0, 1.0, 1.0, 0.0])
    way = TS * np.cumsum(rate)
    way -= way[at]
    path = standing(n)
    path += np.column_stack([np.minimum(way, 0.0), np.maximum(way, 0.0)])
    return path


@pytest.mark.parametrize("speed", [5.0, 15.0])
def test_a_corner_at_speed_is_rounded_where_motors_cannot_turn_it(speed: float) -> None:
    path = corner(800, 400, speed)
    with pytest.raises(LimitError):
        checked([chunk(path, path)], LIMITS)
    result, clamp = clamped(chunk(path, path), LIMITS)
    below(checked([chunk(path, result)], LIMITS).peaks.belt_acceleration, 2000.001, "mm/s²")
    below(clamp.clamped.most, 0.002 * speed, "change of the command, mm")
    np.testing.assert_allclose(result[:290], path[:290], atol=1e-9)


def test_a_clamped_command_stands_where_the_machine_pauses() -> None:
    path = standing(1000)
    path[:, 0] += np.interp(np.arange(1000), [350, 400, 450, 500], [0.0, 0.25, 0.25, 0.5])
    path[:, 1] += np.interp(np.arange(1000), [340, 355], [0.0, 0.1])
    action = Passthrough(0, b"M117", Handling.REST, ModalState(True, False, 0.0, 0.0, (0, 0, 0)))
    dwelling = replace(chunk(path, path, first=300), events=(Dwell(701, 47, action),))
    result, clamp = clamped(dwelling, LIMITS)
    assert clamp.clamped.samples > 0
    np.testing.assert_array_equal(result[400:448], path[400:448])


@pytest.mark.parametrize("away", [60, 100, 140, 200])
def test_a_command_that_dwells_next_to_its_path_dwells_after_a_clamp(away: int) -> None:
    """The bed is left ``away`` samples before a dwell of 60, and another one follows."""
    path = standing(1000, x=0.5)
    command = bumped(standing(1000, x=0.8), 0, -1.2, 60, at=400 - away)
    places = [(400, 460), (500, 540)]
    action = Passthrough(0, b"M117", Handling.REST, ModalState(True, False, 0.0, 0.0, (0, 0, 0)))
    events = tuple(Dwell(a + 1, b - a - 1, action) for a, b in places)
    result, clamp = clamped(replace(chunk(path, command, first=0), events=events), FAR)
    assert clamp.clamped.samples > 0
    for a, b in places:
        np.testing.assert_allclose(result[a:b], np.tile(result[a], (b - a, 1)), atol=1e-12)
    hardest, asked = (np.abs(np.diff(each, n=2, axis=0)).max() for each in (result, command))
    below(hardest, asked + 1e-4, "change of speed in a ms, mm/ms")


@pytest.mark.parametrize("cut", [pytest.param(1, marks=pytest.mark.slow), 7, 100, 399])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_neither_depends_on_how_the_stream_was_cut(cut: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = standing(600, x=0.5)
    command = path.copy()
    for _ in range(3):
        at, width = int(rng.integers(50, 550)), int(rng.integers(10, 120))
        command[:, int(rng.integers(2))] += bump(600, at, rng.normal(), width)
    one = chunk(path, command)
    whole, clamp = clamped(one, LIMITS)
    pieces = Guard(*LIMITS, clamp=True)
    chunks = [each for piece in batches([one], cut) for each in (part(piece, 0, 0), piece)]
    cut_up = join(list(pieces.check(chunks, "racking"))).commands["racking"]
    assert cut_up.tobytes() == whole.tobytes()
    assert pieces.clamped == clamp.clamped
    wide = (Travel((-9.0, 200.0), (0.0, 150.0)), *FAR[1:])
    assert checked(batches([one], cut), wide).peaks == checked([one], wide).peaks


def test_motors_of_which_nobody_stated_a_limit_cancel_racking_in_short_strokes() -> None:
    """With as much as a CoreXY needs, 13 µm were left."""
    lines = [b"G28\n", b"G90\n", b"M83\n", b"G1 X100 Y100 Z0.2 F9000\n", b"M204 S5000\n"]
    for k in range(60):
        lines.append(b"G1 X%d Y%.1f E0.1 F18000\n" % (100 + 3 * (k % 2), 100 + 0.4 * k))
        if k % 3 == 2:
            there = b"G1 X%d F18000\n" % (97 + 3 * (k % 2))
            lines += [b"G1 E-0.8 F1800\n", there, b"G1 E0.8 F1800\n"]
    hbot = load(str(ROOT / "tests" / "benchmarks" / "owners" / "hbot-3000.toml"))
    report = convert(lines, None, hbot)  # which guesses more for the file's acceleration
    below(report.contour["racking"].rms, 8e-3, "RMS contour error, mm")
