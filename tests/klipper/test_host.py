"""The harness itself: what Klipper is known to do comes out of ``play``."""

import math
from pathlib import Path

import numpy as np
import pytest

from .host import BEFORE_2024, KlippyError, Playback, play

pytestmark = pytest.mark.klipper

LIMITS = {
    "max_velocity": 500.0,
    "max_accel": 1000.0,
    "square_corner_velocity": 5.0,
    "minimum_cruise_ratio": 0.0,
}
ROUND_TRIP = """\
G28
G90
M83
G1 X100 Y40 Z0.4 E2 F6000
G1 Y120 E3
G1 E-1.5 F1800
G1 X17.3 Y61.7 F9000
M9999 S1
G1 E1.5 F1800
"""


def play_text(folder: Path, text: str, **limits: float) -> Playback:
    gcode = folder / "input.gcode"
    gcode.write_text(text)
    return play(gcode, limits=LIMITS | limits, workdir=folder / "work")


def trapezoid_time(distance: float, speed: float, accel: float) -> float:
    """Return the time in s from rest to rest for a distance long enough to reach the speed."""
    return distance / speed + speed / accel


@pytest.fixture(scope="module")
def round_trip(tmp_path_factory: pytest.TempPathFactory) -> Playback:
    return play_text(tmp_path_factory.mktemp("round_trip"), ROUND_TRIP)


@pytest.mark.parametrize(("max_velocity", "max_accel"), [(500.0, 1000.0), (80.0, 2500.0)])
def test_two_collinear_lines_take_the_time_of_one_trapezoid(
    tmp_path: Path, max_velocity: float, max_accel: float
) -> None:
    text = "G28\nG1 X60 Y45 F6000\nG1 X120 Y90\n"
    playback = play_text(tmp_path, text, max_velocity=max_velocity, max_accel=max_accel)
    speed = min(100.0, max_velocity)
    assert playback.warnings == ()
    assert len(playback.moves) == 2
    assert playback.duration == pytest.approx(trapezoid_time(150.0, speed, max_accel), abs=1e-9)
    ramp = speed / max_accel
    times = playback.start + np.array([-1.0, ramp, 0.5 * playback.duration, playback.duration, 9.0])
    along = np.array([0.0, 0.5 * speed * ramp, 75.0, 150.0, 150.0])
    expected = along[:, None] * [0.8, 0.6, 0.0]
    np.testing.assert_allclose(playback.position(times), expected, atol=1e-9)


def test_square_corner_velocity_is_kept_in_a_right_angle(tmp_path: Path) -> None:
    playback = play_text(tmp_path, "G28\nG1 X50 F6000\nG1 Y50\n", square_corner_velocity=20.0)
    assert playback.moves["start_v"][1] == pytest.approx(20.0)


def test_minimum_cruise_ratio_keeps_a_short_move_slow(tmp_path: Path) -> None:
    playback = play_text(tmp_path, "G28\nG1 X1 F6000\n", minimum_cruise_ratio=0.5)
    assert playback.moves["cruise_v"][0] == pytest.approx(math.sqrt(0.5 * 1000.0))


def test_an_unknown_command_is_a_warning(round_trip: Playback) -> None:
    assert round_trip.warnings == ('Unknown command:"M9999"',)


def test_commands_of_ordinary_files_are_known(tmp_path: Path) -> None:
    text = """\
M104 S200
M140 S60
G28
M109 S200
M190 S60
M106 S128
EXCLUDE_OBJECT_DEFINE NAME=part
EXCLUDE_OBJECT_START NAME=part
G1 X20 Y20 F6000
G10
G2 X40 Y20 I10 J0
G11
SET_INPUT_SHAPER SHAPER_FREQ_X=0 SHAPER_FREQ_Y=0
SET_VELOCITY_LIMIT ACCEL=50000 SQUARE_CORNER_VELOCITY=100 MINIMUM_CRUISE_RATIO=0
SET_PRESSURE_ADVANCE ADVANCE=0.03
EXCLUDE_OBJECT_END NAME=part
M118 done
M400
M204 S2000
G92 E0
G28
M84
"""
    playback = play_text(tmp_path, text)
    assert playback.warnings == ()
    np.testing.assert_allclose(playback.position([playback.end]), [[0.0, 0.0, 0.0]], atol=1e-9)


@pytest.mark.skipif(BEFORE_2024, reason="each G4 takes Klipper of 2023 two milliseconds more")
def test_a_dwell_takes_its_time(tmp_path: Path) -> None:
    playback = play_text(tmp_path, "G28\nG1 X100 F6000\nG4 P730\nG1 X0\nG4 P1500\n")
    first, second = playback.moves
    rest = second["print_time"] - first["print_time"] - trapezoid_time(100.0, 100.0, 1000.0)
    assert rest == pytest.approx(0.730, abs=1e-9)
    during = second["print_time"] - np.array([0.7, 0.4, 0.1])
    np.testing.assert_allclose(playback.position(during)[:, 0], 100.0, atol=1e-9)
    assert playback.print_time == pytest.approx(playback.end + 1.5, abs=1e-3)


def test_filament_follows_its_own_queue(round_trip: Playback) -> None:
    extruder = round_trip.extruder
    assert len(extruder) == 4
    starts = extruder["print_time"]
    ends = [*starts[1:], round_trip.end]
    np.testing.assert_allclose(round_trip.extruded(starts), [0, 2, 5, 3.5], atol=1e-9)
    np.testing.assert_allclose(round_trip.extruded(ends), [2, 5, 3.5, 5], atol=1e-9)


def test_step_counts_agree_with_the_planner(round_trip: Playback) -> None:
    steps = round_trip.steps()
    x, y, z = round_trip.position([round_trip.end])[0]
    (e,) = round_trip.extruded([round_trip.end])
    np.testing.assert_allclose([x, y, z], [17.3, 61.7, 0.4], atol=1e-9)
    for motor, position in {"A": x + y, "B": x - y, "z": z, "e": e}.items():
        train = steps[motor]
        assert abs(train.direction.sum() * train.size - position) <= train.size


def test_step_times_agree_with_the_planner(round_trip: Playback) -> None:
    steps = round_trip.steps()
    t = np.linspace(round_trip.start, round_trip.end, 5001)
    x, y, z = round_trip.position(t).T
    e = round_trip.extruded(t)
    for motor, position in {"A": x + y, "B": x - y, "z": z, "e": e}.items():
        train = steps[motor]
        assert np.all(np.diff(train.time) > 0.0)
        # A step falls half way; compression may shift it by 25 us, which is 5 um at 212 mm/s.
        slack = 0.5 * train.size + 0.006
        np.testing.assert_allclose(train.position(t), position, atol=slack)


def test_steps_keep_their_time_after_a_long_rest(tmp_path: Path) -> None:
    # The longest rests, shortly under 2^32 ticks, are encoded as negative intervals.
    playback = play_text(tmp_path, "G28\nG1 X50 Z1 F6000\nG4 P1065000\nG1 X51\nG1 Z2\n")
    time = playback.steps()["z"].time
    assert playback.moves["print_time"][2] < time[-1] < playback.end
    assert time[-1] == pytest.approx(playback.end, abs=0.02)


def test_the_last_line_needs_no_newline(tmp_path: Path) -> None:
    playback = play_text(tmp_path, "G28\nG1 X10 F6000\nG1 Y10")
    np.testing.assert_allclose(playback.position([playback.end]), [[10.0, 10.0, 0.0]], atol=1e-9)


def test_a_file_without_motion_plays(tmp_path: Path) -> None:
    playback = play_text(tmp_path, "G28\n")
    assert len(playback.moves) == 0
    assert playback.duration == 0.0
    assert playback.position([0.0, 1.0]).tolist() == [[0.0] * 3] * 2
    assert all(len(train.time) == 0 for train in playback.steps().values())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G28\nG1 X281 F6000\n", "Move out of range"),
        ("G1 X10 F6000\n", "Must home"),
        ("G28\nG1 X10 F0\n", "Invalid speed"),
    ],
)
def test_a_failure_shows_the_log(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(KlippyError, match=message):
        play_text(tmp_path, text)


def test_an_unknown_limit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(KlippyError, match="no_such_limit"):
        play_text(tmp_path, "G28\n", no_such_limit=1.0)


def test_text_that_is_not_utf8_fails(tmp_path: Path) -> None:
    gcode = tmp_path / "latin1.gcode"
    gcode.write_bytes(b"G28\n; 45\xb0\nG1 X10 F6000\n")
    with pytest.raises(KlippyError, match="utf-8"):
        play(gcode, workdir=tmp_path / "work")
