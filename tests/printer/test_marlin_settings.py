"""Marlin's answers and headers, as logs have them, and the profile that they give."""

import tomllib
from pathlib import Path

import pytest

from hframe_post.errors import HframeError
from hframe_post.firmware.marlin.m503 import MarlinSettings, is_of_marlin, text_in
from hframe_post.firmware.marlin.marlin_source import MarlinSource, from_marlin
from hframe_post.printer.firmware_tables import MarlinTable
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
    table = own.firmware.own(MarlinTable)
    assert own.firmware.dialect == "marlin"
    assert (table.max_acceleration, table.max_velocity) == ((3000.0, 2500.0), (500.0, 400.0))
    assert (table.acceleration, table.travel_acceleration) == (1500.0, 2000.0)
    assert (table.junction_deviation, table.classic_jerk) == (0.08, False)
    assert (table.shaper_freq_x, table.shaper_freq_y, table.linear_advance) == (37.5, 29.0, 0.05)
    assert (table.min_segment_time, table.planner) == (0.02, "2.1")
    assert own.extruder is not None
    assert own.extruder.advance == 0.05


BOARDS = tomllib.loads(Path(__file__).with_name("boards.toml").read_text("utf-8"))


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
def test_soft_endstops(answers: Path, answer: str, edges: tuple[tuple[float, float], ...]) -> None:
    own = profile(changed(answers, "ok\n>>> M503", f"{answer}\nok\n>>> M503"))
    assert own.firmware.own(MarlinTable).soft_endstops == edges
    assert (own.travel.x, own.travel.y) == (edges[:2] or ((0.0, 235.0), (0.0, 230.0)))


@pytest.mark.parametrize("board", BOARDS)
def test_answers_of_real_boards(answers: Path, board: str) -> None:
    answers.write_text(BOARDS[board]["answers"])
    tables = from_marlin(MarlinSettings([answers]), BED)
    named = {"kinematics": {"type": Known("cartesian", "test")}, **tables}
    own = parse(profile_text(named, "own"), "own")
    table, steps = own.firmware.own(MarlinTable), own.steps
    assert steps is not None
    read = (
        1 / steps.belt, own.limits.acceleration, table.travel_acceleration,
        own.limits.extruder_acceleration, own.limits.velocity, own.limits.square_corner_velocity,
        table.bed_levelling,
    )  # fmt: skip
    assert read == pytest.approx(tuple(BOARDS[board]["read"]), rel=1e-3)


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
    assert profile(settings).firmware.table(MarlinTable) is not None
    assert (settings.planner.value if settings.planner else "") == planner
    assert any("planner =" in line for line in settings.warnings()) == (not planner)


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
    assert own.firmware.own(MarlinTable).min_steps_per_segment == 8
    header.write_text(HEADER + "#define COREXY\n#define SLOWDOWN\n#define S_CURVE_ACCELERATION\n")
    settings = MarlinSettings([answers, header])
    assert settings.kinematics()[0] == ("corexy", "hbot")
    assert any("SLOWDOWN" in line for line in settings.warnings())
    assert profile(settings, "hbot").firmware.own(MarlinTable).s_curve_acceleration
    header.write_text("#define NO_STANDARD_MOTION\n")
    only = MarlinSettings([answers, header]).planner
    assert only is not None
    assert only.value == "ft-motion"
    header.write_text("#define DELTA\n")
    with pytest.raises(HframeError, match="DELTA"):
        MarlinSettings([answers, header]).kinematics()
