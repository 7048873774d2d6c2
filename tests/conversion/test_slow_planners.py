"""Printers whose owners keep the planner slow print, compensated: M201 is no limit of a motor."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from hframe_post import library
from hframe_post.conversion.options import Options
from hframe_post.conversion.report import Report
from hframe_post.errors import LimitError
from hframe_post.gcode.state import LimitSource
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.command_line import run
from tests.matrix.files import sliced
from tests.quantities import below
from tests.ruler import filled
from tests.simulator import Axis, Machine, Mode

OWNERS = Path(__file__).parent.parent / "matrix" / "owners"
ACCELERATIONS = (500, 1000, 2000, 3000)  # mm/s²
KINDS = {"cartesian": "marlin500", "corexy": "marlin-corexy"}  # and an owner's answer to M503
LAYER = sliced(1).splitlines(keepends=True)  # of a cube


def set_up(folder: Path, kind: str, acceleration: int) -> Printer:
    """Write answers of a printer with this planner, and the profile that `setup` makes of them."""
    answers = (OWNERS / KINDS[kind] / "m503.txt").read_text()
    for words in (r"(M201 X)\d+(\.00 Y)\d+", r"(M204 P)\d+(\.00 R\d+\.00 T)\d+"):
        answers, found = re.subn(words, rf"\g<1>{acceleration}\g<2>{acceleration}", answers)
        assert found == 1
    (folder / "m503.txt").write_text(answers)
    done = run("setup", folder / "m503.txt", "-o", folder, "--kinematics", kind, "--bed", "230,230",
               XDG_CONFIG_HOME=str(folder / "config"), HFRAME_PRINTER="")  # fmt: skip
    assert done.returncode == 0, done.stderr
    return load(str(folder / "printer.toml"))


def measured(profile: Printer, seed: int = 0) -> Printer:
    """Return the profile with the plant of a drawn printer."""
    rng = np.random.default_rng(seed)
    x, y = (
        Axis((Mode(float(rng.uniform(*hz)), float(rng.uniform(0.04, 0.12))),))
        for hz in ((25.0, 60.0), (18.0, 45.0))
    )
    machine = Machine(x, y, 0.0, kinematics=profile.kinematics.type)
    return replace(profile, plant=machine.exact(), invented=False)


def errors(report: Report) -> tuple[float, float]:
    """Return the predicted contour error, µm RMS, without compensation and with it."""
    found = report.as_json()["contour_error_um"]
    return found["none"]["rms"], found["racking"]["rms"]


@pytest.mark.parametrize("acceleration", ACCELERATIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_profile_of_setup_leaves_compensation_what_it_needs(
    tmp_path: Path, kind: str, acceleration: int
) -> None:
    own = measured(set_up(tmp_path, kind, acceleration), acceleration)
    assert own.limits.acceleration == acceleration
    report = library.convert(LAYER, None, own, Options(clamp=False))
    none, compensated = errors(report)
    below(compensated, 0.25 * none, "contour error, µm RMS")


def test_corners_at_speed_decide_what_motors_must_do(tmp_path: Path) -> None:
    own = set_up(tmp_path, "cartesian", 500)
    assert own.limits.square_corner_velocity == 9.83  # M205 J0.08
    assert own.motors.belt_acceleration == round(500 + 9.83 / 2e-3)
    (other := tmp_path / "other").mkdir()
    crossed = set_up(other, "corexy", 3000)  # X8 Y8: less than compensation needs elsewhere
    assert crossed.motors.belt_acceleration == round(2**0.5 * 7500)


@pytest.mark.parametrize("strategy", ["racking", "none"])
def test_a_limit_that_the_owner_states_is_kept_by_a_gentler_command(
    tmp_path: Path, strategy: str
) -> None:
    own = measured(set_up(tmp_path, "cartesian", 500))
    own = replace(own, motors=replace(own.motors, belt_acceleration=1250.0))
    with pytest.raises(LimitError, match="belt acceleration"):
        library.convert(LAYER, None, own, Options(strategy, clamp=False))
    report = library.convert(LAYER, None, own, Options(strategy, ("none", "racking")))
    below(report.peaks.belt_acceleration, 1250.001, "acceleration of a belt, mm/s²")
    below(report.clamped.most, 0.06, "change of the command, mm")
    assert any(warning.startswith("less is compensated ") for warning in report.warnings())
    if strategy == "racking":
        none, compensated = errors(report)
        below(compensated, 0.5 * none, "contour error, µm RMS")


@pytest.mark.slow
@pytest.mark.parametrize("acceleration", ACCELERATIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_an_owner_without_a_sensor_prints(tmp_path: Path, kind: str, acceleration: int) -> None:
    set_up(tmp_path, kind, acceleration)
    profile, form = tmp_path / "printer.toml", tmp_path / "t.form.toml"
    words = ("calibrate-print", "-p", profile, "--heat", "210,60", "-o", tmp_path / "t.gcode")
    assert run(*words).returncode == 0
    form.write_text(filled(form.read_text(), {"x": 42.0, "y": 28.0}))
    done = run("calibrate-print", "--form", form, "-p", profile, "-o", profile)
    assert done.returncode == 0, done.stderr
    for limits in get_args(LimitSource):  # corners as in the file, and the firmware's own
        report = library.convert(LAYER, None, load(str(profile)), Options(limits=limits))
        assert report.clamped.samples == 0, limits
        none, compensated = errors(report)
        below(compensated, 0.25 * none, "contour error, µm RMS")
