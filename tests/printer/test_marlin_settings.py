"""Marlin's answers and headers, as logs have them, and the profile that they give."""

from __future__ import annotations

from pathlib import Path

import pytest

from hframe_post.errors import HframeError
from hframe_post.firmware.marlin.m503 import (
    MarlinSettings,
    MarlinSource,
    from_marlin,
    is_of_marlin,
    text_in,
)
from hframe_post.printer.new_profile import Known, profile_text
from hframe_post.printer.profile import parse
from hframe_post.printer.settings import Printer
from tests.printers import M503

BED = {axis: Known((0.0, 220.0), "test") for axis in "xy"}
HEADER = """
#define X_BED_SIZE 310
#define Y_BED_SIZE (300)
#define Y_MIN_POS -4 // behind the bed
#define X_MAX_POS X_BED_SIZE
//#define COREXZ
#define MIN_STEPS_PER_SEGMENT 8
"""


@pytest.fixture
def answers(tmp_path: Path) -> Path:
    path = tmp_path / "m503.txt"
    path.write_text(M503.read_text())
    return path


def changed(path: Path, old: str, new: str) -> MarlinSettings:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return MarlinSettings([path])


def profile(settings: MarlinSettings, kinematics: str = "cartesian") -> Printer:
    tables = {
        "kinematics": {"type": Known(kinematics, "test")},
        **from_marlin(settings, settings.travel()),
    }
    return parse(profile_text(tables, "own"), "own")


def test_answers_are_compared_with_a_profile(answers: Path) -> None:
    own = profile(MarlinSettings([answers]))
    assert list(MarlinSource([answers]).differing(own, "change it")) == []
    changed(answers, "M92 X80.00 Y80.00", "M92 X160.00 Y160.00")
    (found,) = MarlinSource([answers]).differing(own, "change it")
    assert found.wrong
    assert "steps.belt: 0.00625 (1 / M92 X)" in found.text


def test_a_profile_has_the_values_of_m503_and_m115(answers: Path) -> None:
    own = profile(MarlinSettings([answers]))
    assert (own.travel.x, own.travel.y) == ((0.0, 235.0), (0.0, 230.0))
    assert (own.limits.velocity, own.limits.acceleration) == (400.0, 1500.0)
    assert own.limits.square_corner_velocity == pytest.approx(
        (2.414 * 0.08 * 1500) ** 0.5, rel=0.01
    )
    assert own.steps is not None
    assert (1 / own.steps.belt, 1 / own.steps.e) == pytest.approx((80.0, 93.0))  # of the first tool
    assert own.retraction is not None
    assert (own.retraction.length, own.retraction.speed) == (3.0, 45.0)
    table = own.firmware.marlin
    assert table is not None
    assert own.firmware.dialect == "marlin"
    assert (table.max_acceleration, table.max_velocity) == ((3000.0, 2500.0), (500.0, 400.0))
    assert (table.acceleration, table.travel_acceleration) == (1500.0, 2000.0)
    assert (table.junction_deviation, table.classic_jerk) == (0.08, False)
    assert (table.shaper_freq_x, table.shaper_freq_y, table.linear_advance) == (37.5, 29.0, 0.05)
    assert (table.min_segment_time, table.planner) == (0.02, "2.1")
    assert own.extruder is not None
    assert own.extruder.advance == 0.05


# What owners of these boards have published of their answers to M503: what `setup` reads of them
BOARDS = {
    "Creality, Marlin 2.0, BLTouch": """
  M92 X80.00 Y80.00 Z400.00 E93.00
  M203 X500.00 Y500.00 Z5.00 E25.00
  M201 X500.00 Y500.00 Z100.00 E5000.00
  M204 P500.00 R500.00 T500.00
  M205 B20000.00 S0.00 T0.00 X10.00 Y10.00 Z0.30 E5.00
  M420 S1
""",
    "Artillery, Marlin 2.0": """
; Steps per unit:
 M92 X80.12 Y80.12 Z399.78 E414.26
  M203 X300.00 Y300.00 Z50.00 E40.00
  M201 X2000.00 Y2000.00 Z100.00 E10000.00
; Acceleration (units/s2): P<print_accel> R<retract_accel> T<travel_accel>
  M204 P800.00 R10000.00 T2000.00
  M205 B20000.00 S0.00 T0.00 J0.03
""",
    "Marlin 1.1 of 2017, one jerk for x and y": """
echo:  M92 X80.00 Y80.00 Z400.00 E93.00
echo:  M203 X300.00 Y300.00 Z5.00 E25.00
echo:  M201 X1000 Y1000 Z100 E5000
echo:  M204 P500.00 R500.00 T1000.00
echo:Advanced variables: S=Min feedrate (mm/s), B=minimum segment time (ms), X=maximum XY jerk
echo:  M205 S0.00 T0.00 B20000 X20.00 Z0.40 E5.00
""",
    "a clone of a Prusa, log with times": """
20:31:07.791 -> echo: M92 X100.00 Y100.00 Z400.00 E280.00
20:31:07.791 -> echo:  M203 X200.00 Y200.00 Z12.00 E120.00
20:31:07.791 -> echo:  M201 X1250.00 Y1250.00 Z200.00 E5000.00
20:31:07.838 -> echo:  M204 S1250.00 T1500.00
20:31:07.838 -> echo:  M205 S0.00 T0.00 B20000.00 X10.00 Y10.00 Z0.20 E4.50
""",
    "Prusa MK3, stealth mode too": """
Recv: echo:  M92 X100.00 Y100.00 Z400.00 E280.00
Recv: echo: M350 X16 Y16 Z16 E32
Recv: echo:Maximum feedrates - normal (mm/s):
Recv: echo:  M203 X200.00 Y200.00 Z12.00 E120.00
Recv: echo:Maximum feedrates - stealth (mm/s):
Recv: echo:  M203 X100.00 Y100.00 Z12.00 E120.00
Recv: echo:Maximum acceleration - normal (mm/s2):
Recv: echo:  M201 X1250 Y1250 Z1000 E5000
Recv: echo:Maximum acceleration - stealth (mm/s2):
Recv: echo:  M201 X960 Y960 Z1000 E5000
Recv: echo:Acceleration: P=print, R=retract, T=travel
Recv: echo:  M204 P1250.00 R1250.00 T1250.00
Recv: echo:  M205 S0.00 T0.00 B0.00 X8.00 Y8.00 Z0.40 E4.50
""",
    "CR-10S of 2017, slow filament": """
Recv: echo:  M92 X80.00 Y80.00 Z400.00 E95.00
Recv: echo:  M203 X300.00 Y300.00 Z5.00 E25.00
Recv: echo:  M201 X1000 Y1000 Z100 E25
Recv: echo:  M204 P5000.00 R1000.00 T5000.00
Recv: echo:  M205 S0.00 T0.00 B20000 X20.00 Z0.40 E5.00
""",
    "Snapmaker A350, a rotary axis": """
Recv:   M92 X400.00 Y400.00 Z400.00 B888.89 E258.79
Recv:   M203 X120.00 Y120.00 Z40.00 E25.00
Recv:   M201 X3000.00 Y3000.00 Z100.00 E10000.00
Recv:   M204 P750.00 R1000.00 T1000.00
Recv:   M205 B20000.00 S0.00 T0.00 P0.05 L3.00 C0.05 J0.02
Recv:   M420 S1 Z0.00
""",
    "Tevo, two extruders": """
echo: M92 X80.06 Y80.06 Z399.29
echo: M92 T0 E408.00
echo: M92 T1 E415.00
echo:  M203 X500.00 Y500.00 Z12.00
echo:  M203 T0 E70.00
  M203 T1 E45.00
echo:  M201 X1000.00 Y1000.00 Z100.00
echo:  M201 T0 E3000.00
  M201 T1 E2000.00
echo:  M204 P800.00 R1500.00 T1000.00
echo:  M205 B20000.00 S0.00 T0.00 J0.02
""",
}
# steps per mm, mm/s² of path, travel and retraction, mm/s at most and at corners, mesh
READ = {
    "Creality, Marlin 2.0, BLTouch": (80.0, 500.0, 500.0, 500.0, 500.0, 10.0, True),
    "Artillery, Marlin 2.0": (80.12, 800.0, 2000.0, 10000.0, 300.0, 7.61, False),
    "Marlin 1.1 of 2017, one jerk for x and y": (80.0, 500.0, 1000.0, 500.0, 300.0, 20.0, False),
    "a clone of a Prusa, log with times": (100.0, 1250.0, 1250.0, 1500.0, 200.0, 10.0, False),
    "Prusa MK3, stealth mode too": (100.0, 1250.0, 1250.0, 1250.0, 200.0, 8.0, False),
    "CR-10S of 2017, slow filament": (80.0, 1000.0, 5000.0, 1000.0, 300.0, 20.0, False),
    "Snapmaker A350, a rotary axis": (400.0, 750.0, 1000.0, 1000.0, 120.0, 6.02, True),
    "Tevo, two extruders": (80.06, 800.0, 1000.0, 1500.0, 500.0, 6.22, False),
}  # fmt: skip


@pytest.mark.parametrize(
    ("answer", "edges"),
    [
        ("  M211 S1 ; ON\n  Min:  X-5.00 Y0.00 Z0.00   Max:  X235.00 Y232.00 Z283.00",
         ((-5.0, 235.0), (0.0, 232.0), (0.0, 283.0))),
        ("echo:Soft endstops: On   Min: X0.00 Y0.00 Z0.00  Max: X220.00 Y210.50 Z250.00",
         ((0.0, 220.0), (0.0, 210.5), (0.0, 250.0))),
        ("  M211 S0 ; OFF\n  Min:  X-5.00 Y-5.00 Z0.00   Max:  X300.00 Y300.00 Z400.00", ()),
        ("echo:Soft endstops: Off  Min: X0.00 Y0.00 Z0.00  Max: X220.00 Y210.50 Z250.00", ()),
    ],
)  # fmt: skip
def test_soft_endstops_are_the_range_of_travel(
    answers: Path, answer: str, edges: tuple[tuple[float, float], ...]
) -> None:
    table = (
        own := profile(changed(answers, "ok\n>>> M503", f"{answer}\nok\n>>> M503"))
    ).firmware.marlin
    assert table is not None
    assert table.soft_endstops == edges
    assert (own.travel.x, own.travel.y) == (edges[:2] or ((0.0, 235.0), (0.0, 230.0)))


@pytest.mark.parametrize("board", BOARDS)
def test_answers_of_real_boards(answers: Path, board: str) -> None:
    answers.write_text(BOARDS[board])
    tables = from_marlin(MarlinSettings([answers]), BED)
    named = {"kinematics": {"type": Known("cartesian", "test")}, **tables}
    own = parse(profile_text(named, "own"), "own")
    table, steps = own.firmware.marlin, own.steps
    assert table is not None
    assert steps is not None
    read = (
        1 / steps.belt, own.limits.acceleration, table.travel_acceleration,
        own.limits.extruder_acceleration, own.limits.velocity, own.limits.square_corner_velocity,
        table.bed_levelling,
    )  # fmt: skip
    assert read == pytest.approx(READ[board], rel=1e-3)


def test_whatever_the_log_writes_before_the_answers(answers: Path) -> None:
    plain = profile(MarlinSettings([answers]))
    lines = answers.read_text().splitlines()
    for before in ("Recv: ", "16:42:55.535 > ", "2023-05-01 12:00:00,123 - Recv: "):
        answers.write_text("\r\n".join(before + line for line in lines))
        assert is_of_marlin(text_in(answers))
        own = profile(MarlinSettings([answers]))
        assert (own.limits, own.firmware, own.travel) == (
            plain.limits,
            plain.firmware,
            plain.travel,
        )


@pytest.mark.parametrize(
    ("version", "planner"),
    [
        ("2.0.9.3 (Dec 25 2021 10:00:00)", "2.0"),
        ("2.1.2 (Dec  2 2022 10:00:00)", "2.1"),
        ("2.1.2.1 (Github)", "2.1"),
        ("bugfix-2.1.x (Jul 20 2024 21:12:30)", "2.1"),
        ("bugfix-2.1.x (Nov 20 2024 21:12:30)", "2.1-dev"),
        ("2.1.3 (Jan  2 2026 10:00:00)", "2.1-dev"),
        ("V1.0.4 (Mar  2 2022 10:00:00)", ""),  # a vendor's own number
        ("1.1.9 (Github)", ""),
        ("bugfix-2.1.x", ""),
    ],
)
def test_the_version_tells_the_planner(answers: Path, version: str, planner: str) -> None:
    settings = changed(answers, "2.1.2.1 (May 15 2023 12:00:00)", version)
    assert profile(settings).firmware.marlin is not None
    assert (settings.planner.value if settings.planner else "") == planner
    assert any("measure --for planner" in line for line in settings.warnings()) == (not planner)


def test_headers_add_what_the_answers_leave_open(answers: Path, tmp_path: Path) -> None:
    assert len(MarlinSettings([answers]).kinematics()[0]) > 2
    header = tmp_path / "Configuration.h"
    header.write_text(HEADER)
    answers.write_text(
        "".join(line for line in answers.read_text().splitlines(True) if "area:" not in line)
    )
    settings = MarlinSettings([answers, header])
    own = profile(settings)
    assert settings.kinematics()[0] == ("cartesian",)
    assert (own.travel.x, own.travel.y) == ((0.0, 310.0), (-4.0, 300.0))
    assert own.firmware.marlin is not None
    assert own.firmware.marlin.min_steps_per_segment == 8
    header.write_text(HEADER + "#define COREXY\n#define SLOWDOWN\n#define S_CURVE_ACCELERATION\n")
    settings = MarlinSettings([answers, header])
    assert settings.kinematics()[0] == ("corexy", "hbot")
    assert any("SLOWDOWN" in line for line in settings.warnings())
    marlin = profile(settings, "hbot").firmware.marlin
    assert marlin is not None
    assert marlin.s_curve_acceleration
    header.write_text("#define NO_STANDARD_MOTION\n")
    only = MarlinSettings([answers, header]).planner
    assert only is not None
    assert only.value == "ft-motion"
    header.write_text("#define DELTA\n")
    with pytest.raises(HframeError, match="DELTA"):
        MarlinSettings([answers, header]).kinematics()
