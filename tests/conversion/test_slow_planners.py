"""Printers whose owners keep the planner slow print, compensated: M201 is no limit of a motor."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post import library
from hframe_post.conversion.options import Options
from hframe_post.conversion.print_report import Report
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.command_line import run
from tests.gcode_tools import sliced
from tests.quantities import below
from tests.simulator import Axis, Machine, Mode

OWNERS = Path(__file__).parent.parent / "owners"
LAYER = sliced(1)  # of a cube


def set_up(folder: Path, kind: str, acceleration: int) -> Printer:
    """Write answers of a printer with this planner, and the profile that `setup` makes of them."""
    answers = (OWNERS / "marlin500" / "m503.txt").read_text()
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


@pytest.mark.parametrize(
    ("kind", "acceleration"), [("cartesian", 500), ("corexy", 1000), ("cartesian", 3000)]
)
def test_setup_leaves_what_compensation_needs(tmp_path: Path, kind: str, acceleration: int) -> None:
    own = measured(set_up(tmp_path, kind, acceleration), acceleration)
    assert own.limits.acceleration == acceleration
    commands = WholeFile(LAYER, own, Options(clamp=False).resolved(own))  # not yet whole steps
    for _ in commands.samples():
        pass
    none, compensated = errors(commands.report)
    below(compensated, 0.25 * none, "contour error, µm RMS")


def test_motors_that_the_owner_states_get_a_slower_path(tmp_path: Path) -> None:
    own = measured(set_up(tmp_path, "cartesian", 500))
    own = replace(own, motors=replace(own.motors, belt_acceleration=1250.0))
    report = library.convert(LAYER, None, own, Options("racking", ("none", "racking"), clamp=False))
    below(report.peaks.belt_acceleration, 1250.001, "acceleration of a belt, mm/s²")
    none, compensated = errors(report)
    below(compensated, 0.5 * none, "contour error, µm RMS")
    assert report.slowed > 0.1
    assert "the limits in [motors] slow down" in report.as_text()
