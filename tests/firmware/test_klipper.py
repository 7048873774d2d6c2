"""What Klipper makes of a stream: its time for each segment, its commands, its macros."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.firmware.klipper.klipper_stream import KlipperCode, KlipperMotion, stream_limits
from hframe_post.firmware.klipper.macros import WRAPPERS, macros
from hframe_post.firmware.motion import Way
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.firmware_tables import END_MACRO, RECORDED, KlipperTable
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Extruder, Limits, Motors
from hframe_post.stream.types import Handling, ModalState, Passthrough
from tests.quantities import below

STREAM = Limits(
    velocity=770.0, acceleration=3.5355e4, square_corner_velocity=20.0, z_velocity=20.0,
    z_acceleration=500.0, extruder_velocity=60.0, extruder_acceleration=2000.0,
)  # fmt: skip

# ---------------------------------------------------------------------- speeds and durations


def test_speeds_that_swing_half_as_hard_as_the_motors_hold_keep_time() -> None:
    """Where the stream is 5 % too fast, the nozzle is not where it was planned."""
    limit = replace(STREAM, acceleration=12_500.0)
    T, t = np.full(200, 2e-3), 2e-3 * np.arange(200)
    v = 65.0 + 55.0 * np.sin(0.5 * limit.acceleration / 55.0 * t)
    delta = np.zeros((200, 4))
    delta[:, 0] = v * T
    rest = np.zeros(201, dtype=bool)
    motion = KlipperMotion(RESTORE, limit)
    at = np.cumsum(np.vstack([np.zeros(4), delta]), axis=0)
    taken = motion.feeds(at, T, rest, float(v[0]), math.inf, per_feed=6e9)[1]
    below(np.abs(taken - T).max(), 2e-6, "greatest error of a segment's time, s")
    below(abs(float((taken - T).sum())), 2e-5, "error of the time of all, s")


def test_a_leap_that_no_ramp_makes_in_time_is_made_up_for() -> None:
    """From rest: a crawl, the leap, then plain motion that hurries by a twenty-fifth."""
    T = np.full(40, 2e-3)
    T[1] = 1e-3
    speed = np.full(40, 60.0)
    speed[:3] = 6.0, 45.0, 60.0
    at = np.zeros((41, 4))
    at[1:, 0] = np.cumsum(speed * T)
    motion, rest = KlipperMotion(RESTORE, STREAM), np.zeros(41, dtype=bool)
    rest[0] = True
    late = motion.feeds(at, T, rest, 0.0, math.inf, per_feed=6e9)[1] - T
    assert 1e-4 < late[1] < 5e-4
    below(np.abs(np.cumsum(late)[15:]).max(), 1e-5, "lateness after 15 segments, s")
    below(-late[2:].min(), 0.05 * 2e-3, "time made up in a segment, s")


def test_a_lift_from_motion_is_slowed_to_be_in_time_by_a_tenth_at_most() -> None:
    motion, way = KlipperMotion(RESTORE, STREAM), Way((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 2.0, 0.0))
    own = motion.stroke(way, 10.0, 0.3, 0.0, entry=2.0).seconds
    for wanted, taken in ((1.05 * own, 1.05), (3.0 * own, 1.1)):
        stroke = motion.stroke(way, 10.0, 0.3, wanted, entry=2.0)
        assert stroke.seconds == pytest.approx(taken * own)


# ---------------------------------------------------------------------- commands

RESTORE = KlipperTable(300.0, 3000.0)
AT = np.array([12.5, 30.0, 0.2, 7.0])
STATE = ModalState(True, False, 0.0, 100.0, (0.0, 0.0, 0.0))


def end(state: ModalState = STATE, restore: KlipperTable = RESTORE) -> list[str]:
    return KlipperCode(restore, STREAM).end(state, AT)


def test_the_stream_may_do_what_the_motors_hold_in_any_direction_and_no_more() -> None:
    limits = Limits(300.0, 1e4, 5.0, 20.0, 500.0, 60.0, 2000.0, 1.5)
    own = replace(load("paper"), limits=limits, motors=Motors(700.0, 5e4), kinematics=Kinematics())
    stream = stream_limits(own)
    assert stream.velocity == pytest.approx(770.0)
    assert stream.acceleration == math.floor(5e4 / math.sqrt(2.0))  # 5e4 along a diagonal's belt
    assert (stream.z_velocity, stream.z_acceleration) == (20.0, 500.0)
    assert (stream.extruder_velocity, stream.extruder_acceleration) == (60.0, 2000.0)
    assert stream.extruder_corner_velocity == 1.5


USERS = (
    "SET_VELOCITY_LIMIT VELOCITY=300 ACCEL=3000 SQUARE_CORNER_VELOCITY=5 MINIMUM_CRUISE_RATIO=0.5"
)


def test_stream_ends_with_the_users_limits_and_the_files_feed() -> None:
    assert end() == ["G4 P0", USERS, "G1 F6000"]


def test_a_move_that_stays_as_it_is_has_the_users_limits_and_the_files_feed() -> None:
    move = Passthrough(1, b"G1 X5", Handling.RELEASE, STATE, end=(5.0, 0.0, 0.0, 0.0))
    around = KlipperCode(RESTORE, STREAM).around(move)
    assert around is not None
    assert around[0] == ["G4 P0", USERS, "G1 F6000"]
    assert " VELOCITY=770 ACCEL=35355 " in around[1][1]


@pytest.mark.parametrize(("x", "y", "z"), [(52.5, 38.0, 0.0), (0.0, 38.0, 0.0), (0.0, 0.0, 22.0)])
def test_shaper_is_restored_where_the_user_has_one(x: float, y: float, z: float) -> None:
    lines = end(restore=replace(RESTORE, shaper_freq_x=x, shaper_freq_y=y, shaper_freq_z=z))
    words = f"SHAPER_FREQ_X={x:g} SHAPER_FREQ_Y={y:g} SHAPER_FREQ_Z={z:g}"
    assert lines[2] == f"SET_INPUT_SHAPER {words}"


def test_the_stream_averages_pressure_advance_over_a_time_of_its_own() -> None:
    code = KlipperCode(replace(RESTORE, end_macro="HFRAME_END"), STREAM, Extruder(0.05, 0.04, 0.02))
    own = "SET_PRESSURE_ADVANCE SMOOTH_TIME=0.02"
    assert code.begin((0.0, 0.0, 0.0), AT)[3] == own
    assert code.end(STATE, AT)[2:4] == ["HFRAME_END", "SET_PRESSURE_ADVANCE SMOOTH_TIME=0.04"]
    of_file = replace(STATE, smooth_time=0.03)
    assert code.end(of_file, AT)[3] == "SET_PRESSURE_ADVANCE SMOOTH_TIME=0.03"
    for line, after in (
        (b"SET_PRESSURE_ADVANCE ADVANCE=0.1 SMOOTH_TIME=0.03", f"{own}\n".encode()),
        (b"SET_PRESSURE_ADVANCE ADVANCE=0.1", b""),
    ):
        assert code.modes_after("SET_PRESSURE_ADVANCE", line) == after


@pytest.mark.parametrize(
    ("absolute", "absolute_e", "expected"),
    [
        (True, True, ["M82", "G92 E1234.56789"]),
        (False, True, ["M82", "G92 E1234.56789", "G91"]),
        (False, False, ["G91"]),
        (True, False, []),
    ],
)
def test_modes_come_back(absolute: bool, absolute_e: bool, expected: list[str]) -> None:
    state = ModalState(absolute, absolute_e, 1234.56789, 41.25, (0.0, 0.0, 0.0))
    assert end(state)[2:] == ["G1 F2475", *expected]


# ---------------------------------------------------------------------- filament


def test_no_segment_extrudes_more_than_klipper_takes_for_its_length() -> None:
    """0.4 mm lines, then a crawl in which the path, not the command, has gone on."""
    e = np.concatenate([np.linspace(0.0, 6.0, 601), 6.0 + np.linspace(0.0, 1.0, 101)[1:]])
    x = np.concatenate([np.linspace(0.0, 180.0, 601), 180.0 + np.linspace(0.0, 0.6, 101)[1:]])
    points = np.zeros((701, 4))
    points[:, 0], points[:, 3] = x, e
    motion = KlipperMotion(RESTORE, STREAM, tolerance=0.005)
    ends, at = motion.segments(points, np.zeros(701, dtype=bool), True)
    assert ends[-1] == 700
    assert (np.diff(ends) > 0).all()
    moved = np.diff(at, axis=0, prepend=points[:1])
    length, filament = np.abs(moved[:, 0]), moved[:, 3]
    ratio, least = 4.0 * 0.4**2 / (math.pi * 1.75**2 / 4.0), 0.4 * 4.0 * 0.4**2 / 2.405
    assert ((filament <= ratio * length) | (filament <= least)).all()
    assert len(ends) < 40  # the plain lines stay long segments
    np.testing.assert_array_equal(points[ends, 3], at[:, 3])


# ---------------------------------------------------------------------- plain numbers


DOCS = Path(__file__).parents[2] / "docs" / "klipper.md"


def test_the_docs_name_each_macro() -> None:
    names = {*re.findall(r"\[gcode_macro ([A-Z]\w+)\]", macros(load("paper")))}
    names |= {"_HFRAME_BEGIN", END_MACRO, RECORDED, *WRAPPERS}
    assert len(names) == 9
    assert not [name for name in names if f"`{name}`" not in DOCS.read_text(encoding="utf-8")]
