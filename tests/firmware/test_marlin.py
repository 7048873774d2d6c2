"""The Marlin mode: commands, whole steps, filament, order, modes, equal bytes."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.conversion.options import Options
from hframe_post.conversion.print_report import NO_GAIN
from hframe_post.errors import GcodeError, PrinterError
from hframe_post.firmware.marlin.marlin_code import MarlinCode
from hframe_post.firmware.marlin.marlin_motion import MarlinMotion
from hframe_post.firmware.motion import Stroke, Way
from hframe_post.firmware.registry import firmware
from hframe_post.model.kinematics import Kinematics
from hframe_post.native.whole_steps import without_reversals
from hframe_post.printer.firmware_tables import MARLIN_PLANNERS
from hframe_post.printer.profile import load, parse, played_by, shipped
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import ModalState, Position
from tests.gcode_tools import assert_same_stream, converted, follow, layers, quirk, sample
from tests.printers import JERK, with_marlin
from tests.quantities import below

QUIRKS = Path(__file__).parent.parent / "quirks"
NOWHERE = (0.0, 0.0, 0.0)
AT = np.array([12.5, 30.0, 0.2, 7.0])
STATE = ModalState(True, False, 0.0, 100.0, NOWHERE)


def from_there(way: Position) -> Way:
    x, y, z, e = AT.tolist()
    return Way((x, y, z, e), (x + way[0], y + way[1], z + way[2], e + way[3]))


@pytest.fixture(scope="module")
def marlin() -> Printer:
    return load("paper-marlin")


def code(profile: Printer) -> MarlinCode:
    found = firmware(profile).code()
    assert isinstance(found, MarlinCode)
    return found


def motion(profile: Printer) -> MarlinMotion:
    found = firmware(profile).motion(None)
    assert isinstance(found, MarlinMotion)
    return found


# ---------------------------------------------------------------------- commands


def test_stream_ends_with_the_users_settings_to_the_last_digit(marlin: Printer) -> None:
    mine = with_marlin(
        marlin, max_acceleration=(9000.125, 7000.375), max_acceleration_e=1800.625,
        max_velocity=(280.125, 310.375), acceleration=2800.125, travel_acceleration=2900.375,
        retract_acceleration=1234.625, min_segment_time=0.012345, min_velocity=0.125,
        min_travel_velocity=0.375, junction_deviation=0.0125, linear_advance=0.04125,
        shaper_freq_x=41.125, shaper_freq_y=38.625,
    )  # fmt: skip
    assert code(mine).end(STATE, AT)[1:-2] == [
        "M201 X9000.125 Y7000.375 Z500 E1800.625", "M203 X280.125 Y310.375",
        "M204 P2800.125 T2900.375 R1234.625", "M205 B12345 S0.125 T0.375 J0.0125",
        "M900 K0.04125", "M593 X F41.125", "M593 Y F38.625",
    ]  # fmt: skip


@pytest.mark.parametrize("planner", ["2.0", "2.1"])
def test_segments_begin_at_their_own_speed_with_classic_jerk(marlin: Printer, planner: str) -> None:
    """Its jerk in the stream limits nothing; with a junction deviation they begin at rest."""
    at = np.array([[100.0, 100.0, 1.0, 0.0], [110.0, 100.0, 1.0, 0.5]])
    for own, begins in ((JERK, 80.0), ({}, 0.0)):
        mine = motion(with_marlin(marlin, planner=planner, **own))
        assert mine.entry(at, 80.0, 0.0) == begins, "mm/s"
        assert mine.entry(at, 80.0, 90.0) == 80.0, "mm/s, after a faster one"


@pytest.mark.parametrize("planner", MARLIN_PLANNERS)
def test_strokes_last_as_long_as_they_were_planned_to(marlin: Printer, planner: str) -> None:
    """The speeds of the user's corners would make them faster than from rest to rest."""
    mine = motion(with_marlin(marlin, planner=planner))
    for way, speed in (((0.0, 0.0, 0.4, 0.0), 10.0), ((0.0, 0.0, 0.0, -2.0), 40.0)):
        a = mine.code.limits.z_acceleration if way[2] else mine.code.limits.extruder_acceleration
        planned, stroked = max(map(abs, way)) / speed + speed / a, from_there(way)
        corners = mine.corners(stroked, speed, (0.0, 0.0))
        stroke = mine.stroke(stroked, speed, planned, planned, *corners)
        assert stroke.seconds == pytest.approx(planned, abs=1e-3)
        assert 0.5 * speed < stroke.speed < speed
        at_once = mine.stroke(stroked, speed, planned, 0.0, *corners)
        assert at_once.speed == speed
        assert (at_once.cruise > 0.0) == mine.planner.fixed_time, "mm that others do not ask for"


def test_what_follows_a_late_stroke_is_no_faster_than_it_allows() -> None:
    stroke = Stroke(40.0, 0.1, fastest=50.0, cruise=0.2)
    assert stroke.time_of_next(1.0, 0.01) == pytest.approx(1.0 / 50.0)


def test_limits_are_set_in_whole_numbers_and_corners_to_a_hundredth(marlin: Printer) -> None:
    assert code(with_marlin(marlin, **JERK)).set_limits(150.4, 1234.6, 3.14159)[4:] == [
        "M201 X1235 Y1235", "M203 X150 Y150", "M204 P1235 T1235", "M205 B0 S0 T0 X3.14 Y3.14",
    ]  # fmt: skip
    assert code(marlin).set_limits(150.0, 1000.0, 5.0)[-1] == "M205 B0 S0 T0 J0.0104"


@pytest.mark.parametrize("planner", ["2.1-dev", "ft-motion"])
def test_s_curves_are_refused_where_they_are_not_known(planner: str) -> None:
    own = f'[firmware.marlin]\nplanner = "{planner}"\ns_curve_acceleration = true\n'
    with pytest.raises(PrinterError, match=r"s_curve_acceleration: .*turn it off in Marlin"):
        parse(f'extends = "paper-marlin"\n{own}', "mine")


@pytest.mark.parametrize(
    ("absolute", "absolute_e", "expected"),
    [
        (True, True, ["M82", "G92 E1234.56789"]), (True, False, ["G92 E1234.56789"]),
        (False, False, ["G91", "G92 E1234.56789"]),
        (False, True, ["G91", "M82", "G92 E1234.56789"]),
    ],
)  # fmt: skip
def test_modes_of_the_file_come_back(
    marlin: Printer, absolute: bool, absolute_e: bool, expected: list[str]
) -> None:
    """G91 is for E, too, so it comes before M82."""
    state = ModalState(absolute, absolute_e, 1234.56789, 41.25, NOWHERE)
    end = code(marlin).end(state, AT)
    assert end[end.index("G1 F2475") + 1 :] == expected


def test_counting_filament_again_keeps_the_fraction_of_a_step(marlin: Printer) -> None:
    """Marlin rounds to whole steps, and the steps of filament decide the acceleration."""
    assert marlin.steps is not None
    for filament in (50.00123, 7.0, 0.0):
        counted = float(code(marlin).reset_extruder(filament).split(b"E")[1])
        steps = (filament - counted) / marlin.steps.e
        assert steps == pytest.approx(round(steps), abs=0.01)
        assert 0.0 <= counted < marlin.steps.e


# ---------------------------------------------------------------------- the stream


@pytest.fixture(scope="module")
def cube(marlin: Printer) -> tuple[bytes, bytes]:
    lines = layers("cube.gcode", 6)
    return b"".join(lines), converted(lines, marlin)[0]


def test_filament_is_conserved(cube: tuple[bytes, bytes]) -> None:
    sliced, ours = (follow(text, marlin=True).filament for text in cube)
    assert ours == pytest.approx(sliced, abs=1e-4)


def test_no_feed_rate_is_zero_and_nothing_waits(cube: tuple[bytes, bytes]) -> None:
    assert b"G4" not in cube[1]
    assert min(float(f) for f in re.findall(rb"^G1.* F([\d.]+)", cube[1], re.MULTILINE)) > 1.0


def test_filament_is_counted_anew_before_floats_forget(marlin: Printer) -> None:
    """Else E of a long print has steps of 0.001 mm in Marlin's floats."""
    text = converted(layers("cube.gcode", 20), marlin)[0]
    e = most = 0.0
    for line in text.splitlines():
        if line.startswith(b"G92 E"):
            e = 0.0
        elif line.startswith(b"G1") and b" E" in line:
            e += float(re.findall(rb" E(-?[\d.]+)", line)[0])
            most = max(most, abs(e))
    assert 10.0 < most < 64.0


def test_bound_on_lines_is_kept_or_told(marlin: Printer) -> None:
    for bound in (60.0, 125.0, 500.0):
        report = converted(sample("rectangle.gcode"), with_marlin(marlin, lines_per_second=bound))[
            1
        ]
        assert report.written.busiest_second <= bound
        assert "lines in a second" not in report.as_text()
    hops = [b"G1 X100 Y100 Z1 F6000\n"]
    hops += [b"G1 X%d Z%d\n" % (100 + k % 2, 1 + k % 2) for k in range(4)]
    hops += [b"G1 E%s F3600\n" % (b"0.1" if k % 2 else b"0") for k in range(300)]
    report = converted(hops, with_marlin(marlin, lines_per_second=60.0))[1]
    assert "lines in a second" in report.as_text()


def test_short_segments_do_not_cut_turns_off() -> None:
    """Settling at stops turns x and y back at different moments, a few steps apart."""
    ender = load("example-ender")
    report = converted(layers("cube.gcode", 1), ender, Options("racking", ("racking",)))[1]
    below(report.contour["racking"].rms, 0.004, "contour error with whole steps, mm RMS")


def test_no_motion_goes_straight_back() -> None:
    """Marlin would stop there; the vertex after it goes a step to where the command is."""
    x = np.array([0, 6, 0, 6, 14, 8])
    vertices = np.stack([x, 0 * x], axis=1)
    off = np.full(vertices.shape, -0.3)
    matrix = Kinematics("cartesian").matrix
    moved = without_reversals(vertices, off, matrix, 6)
    assert moved[:, 1].tolist() == [0, 0, -1, -1, 0, 0]
    assert moved[:, 0].tolist() == x.tolist()
    upright = np.array([[0, 0], [6, 0], [0, 0], [0, -6]])  # the last segment would be too short
    assert without_reversals(upright, off[:4], matrix, 6).tolist() == upright.tolist()
    assert without_reversals(moved, off, matrix, 6).tolist() == moved.tolist()


def test_a_print_that_whole_steps_spoil_is_reported(marlin: Printer) -> None:
    """A slow one with coarse steps on a printer that hardly rings: it is off by half a step."""
    options = Options("racking", ("none", "racking"))
    ender = load("example-ender")
    assert ender.steps is not None
    coarse = replace(ender, steps=replace(ender.steps, belt=0.05))
    for printer, slow in ((coarse, True), (ender, False), (marlin, False)):
        report = converted(layers("cube.gcode", 1), printer, options)[1]
        assert ("better as sliced" in report.as_text()) == slow
        um, shaper = report.as_json()["contour_error_um"], report.as_json()["against"][0]
        ours, shaped = um["racking"]["rms"], shaper["contour_error_um"]["rms"]
        assert (um["none"]["rms"] <= ours) == slow
        assert ("the best input shaper does" in report.as_text()) == (printer is ender)
        assert (ours > NO_GAIN * shaped) == (printer is not marlin)


@pytest.mark.parametrize("planner", MARLIN_PLANNERS)
def test_rectangle(marlin: Printer, golden: Callable[[str, bytes], bytes], planner: str) -> None:
    """Other machines may round to another tick of the timer."""
    whole = converted(sample("rectangle.gcode"), with_marlin(marlin, planner=planner))[0]
    rows = whole.splitlines(keepends=True)
    now = b"".join([*rows[:1], *rows[2:]])  # the stamp apart: it changes with every option
    assert_same_stream(now, golden(f"rectangle.marlin-{planner}.gcode", now))


def test_fixed_time_motion_is_on_without_shapers_while_the_stream_runs(marlin: Printer) -> None:
    mine = code(with_marlin(marlin, planner="ft-motion", fixed_time_shaper=(1.0, 8.0)))
    assert "M493 S1 X0 Y0 C0 P0" in mine.begin(NOWHERE, AT)
    end = mine.end(STATE, AT)
    assert [line for line in end if "M493" in line] == ["M493 S0", "M493 X1 C1", "M493 Y8 C8"]


def test_trajectory_and_smoothing_are_those_of_the_user_again(marlin: Printer) -> None:
    smoothed = with_marlin(marlin, fixed_time_trajectory=2, fixed_time_smoothing=(0.02, 0.03))
    assert "M494 T0 X0 Y0 Z0 E0" in code(smoothed).begin(NOWHERE, AT)
    assert "M494 T2 X0.02 Y0.03 Z0 E0" in code(smoothed).end(STATE, AT)
    assert not any("M494" in line for line in code(marlin).end(STATE, AT))


def test_advance_is_computed_into_e_and_said(marlin: Printer) -> None:
    """A line's filament is that of the file at both ends; in between E is ahead of it."""
    lines = [b"M83\n", b"G1 X100 Y100 Z1 F6000\n", b"G1 X160 E2\n", b"G1 X100 E2\n"]
    plain, advanced = (converted(lines, with_marlin(marlin, linear_advance=K)) for K in (0.0, 0.05))
    assert advanced[1].advancing.most
    said = (
        "advance          0.05 s, computed into E; the firmware's own is off while the file moves"
    )
    assert said in advanced[1].as_text()
    assert not plain[1].advancing.most
    fed = [np.array(re.findall(rb"E(-?[\d.]+)", text), float) for text, _ in (plain, advanced)]
    assert fed[0].min() >= 0.0
    assert fed[1].min() < -0.01  # where it brakes
    assert fed[0].sum() == pytest.approx(fed[1].sum(), abs=1e-9)
    assert b"M900 K0.05" in advanced[0].splitlines()
    by_the_file = [*lines[:3], b"M900 K0.05\n", lines[3]]  # none is in force before
    assert converted(by_the_file, marlin)[1].advancing.most == 0.05


@pytest.mark.parametrize("planner", MARLIN_PLANNERS)
def test_a_feed_rate_of_whole_steps_is_that_of_the_board(marlin: Printer, planner: str) -> None:
    """Boards round steps a second up, or to the nearest."""
    moves = firmware(with_marlin(marlin, planner=planner)).moves()
    for steps in (150, 151, 9000):
        written = moves.speed((steps + 0.3) * moves.step) / moves.step
        assert (math.ceil(written), round(written)) == (steps, steps)


def test_a_slow_sender_gets_fewer_lines(marlin: Printer) -> None:
    slow, usual = (with_marlin(marlin, baud=250_000, latency=t) for t in (4e-3, 2e-3))
    assert motion(slow).lines_per_second == pytest.approx(172.4, abs=0.1)
    assert motion(usual).lines_per_second == 250.0
    assert "takes 4 ms (latency)" in code(slow).notices[0]


@pytest.mark.parametrize(
    ("own", "users", "ours"),
    [({}, b"M205 J0.013", b"M205 J0.3"), (JERK, b"M205 E5", b"M205 E1000")],
)
def test_retractions_begin_as_the_users_do(
    marlin: Printer, own: dict[str, object], users: bytes, ours: bytes
) -> None:
    lines = [b"M83\n", b"G1 X100 Y100 Z1 F6000\n", b"G1 X120 E1\n", b"G1 E-3 F2700\n", b"G1 X140\n"]
    text = converted(lines, with_marlin(marlin, **own))[0].splitlines()
    (retraction,) = (k for k, line in enumerate(text) if line.startswith(b"G1 E-3 F"))
    assert text[retraction - 1] == users
    assert text[retraction + 2] == ours


def test_a_prime_is_as_fast_as_a_retraction_may_be_and_no_faster(marlin: Printer) -> None:
    """Marlin has the same M203 E and M204 R both ways, and no limit of what a hot end melts."""
    lines = [b"M83\n", b"G1 X100 Y100 Z1 F6000\n", b"G1 X120 E1\n", b"G1 E-3 F9000\n", b"G1 X140\n",
             b"G1 E3 F9000\n", b"G1 X120 E1 F6000\n"]  # fmt: skip
    text = converted(lines, marlin)[0]
    ways = dict(re.findall(rb"^G1 E(-?3) F([\d.]+)$", text, re.MULTILINE))
    fastest = 60.0 * marlin.limits.extruder_velocity
    assert {way: float(feed) <= fastest for way, feed in ways.items()} == {b"-3": True, b"3": True}


def test_linear_advance_of_the_file_does_not_enter_the_stream(marlin: Printer) -> None:
    lines = [b"G1 X100 Y100 Z1 F6000\n", b"G1 X110\n", b"M900 K0.08\n", b"G1 X120\n"]
    text = converted(lines, marlin)[0].splitlines()
    assert text[text.index(b"M900 K0.08") + 1] == b"M900 K0"
    assert text.count(b"M900 K0.08") == 2  # in force again at the end


@pytest.mark.parametrize("name", sorted(path.stem for path in QUIRKS.iterdir()))
def test_quirks_convert_or_are_refused_as_for_klipper(marlin: Printer, name: str) -> None:
    lines = quirk(name)
    printed = []
    for each in (marlin, played_by(marlin, "klipper")):
        try:
            converted(lines, each, Options("racking", clamp=True))
            printed.append("")
        except GcodeError as error:
            printed.append(str(error))
    assert printed[0] == printed[1]


# ---------------------------------------------------------------------- segments


@given(
    st.integers(0, 2**32 - 1), st.sampled_from(["hbot", "corexy", "hybrid-corexy", "cartesian"]),
    st.sampled_from([125.0, 250.0, 1000.0]), st.booleans(),
)  # fmt: skip
def test_segments_are_long_on_any_path(seed: int, kind: str, rate: float, last: bool) -> None:
    """Motion with standstill and reversals: ends ascend, and all but the last have their steps."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 900))
    v = np.cumsum(rng.normal(0.0, 0.01, (n, 2)), axis=0) * (rng.random((n, 1)) > 0.1)
    v[n // 3 : n // 2] = 0.0
    points = np.zeros((n + 1, 4))
    points[1:, :2] = np.cumsum(v, axis=0)
    paper = replace(with_marlin(load("paper-marlin"), lines_per_second=rate))
    machine = motion(replace(paper, kinematics=Kinematics(kind)))
    ends, at = machine.segments(points, np.zeros(n + 1, dtype=bool), last)
    assert (np.diff(ends) > 0).all()
    assert not last or ends[-1] == n
    assert paper.steps is not None
    cells = np.vstack([np.rint(points[:1, :2] / paper.steps.belt), at[:, :2] / paper.steps.belt])
    motors = np.rint(cells) @ machine.kinematics.matrix.T
    steps = np.abs(np.diff(motors, axis=0)).max(axis=1)
    assert ((steps >= 6) | (steps == 0))[: len(steps) - 1 if last else None].all()


# ---------------------------------------------------------------------- the profile


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("junction_deviation = 0.013", "", "junction_deviation"),
        ("linear_advance = 0.0", "jerk = [8.0, 8.0]\njerk_e = 5.0", "junction_deviation"),
        ("junction_deviation = 0.013", "jerk = [8.0, 8.0]", "junction_deviation"),
        ("junction_deviation = 0.013", "junction_deviation = -1", "junction_deviation"),
        ("max_velocity = [300.0, 300.0]", "max_velocity = [0, 300.0]", "max_velocity"),
        ("max_velocity = [300.0, 300.0]", "", "max_velocity"),
        ("lines_per_second = 250.0", "lines_per_second = 2000.0", "lines_per_second"),
        ("lines_per_second = 250.0", "min_steps_per_segment = 0", "min_steps_per_segment"),
        ("lines_per_second = 250.0", "accel = 1", "accel"),
    ],
)  # fmt: skip
def test_bad_settings_name_their_key(old: str, new: str, key: str) -> None:
    text = shipped()["paper-marlin"]
    assert old in text
    with pytest.raises(PrinterError) as caught:
        parse(text.replace(old, new), "mine")
    assert caught.value.key == f"firmware.marlin.{key}"
