"""Weak motors, and planners that owners keep slow: converted within what is stated, no less."""

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post import library
from hframe_post.arrays import TS
from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from hframe_post.stream.chunks import stretches
from hframe_post.stream.types import Samples
from tests.command_line import run
from tests.gcode_tools import converted, layers, quirk, sliced
from tests.quantities import below
from tests.simulator import Axis, Machine, Mode

OWNERS = Path(__file__).parents[1] / "benchmarks/owners"


def weak(owner: str, belt_acceleration: float) -> Printer:
    """Return an owner's printer with motors of a stated acceleration, mm/s²."""
    printer = load(str(OWNERS / f"{owner}.toml"))
    return replace(printer, motors=replace(printer.motors, belt_acceleration=belt_acceleration))


def test_stops_that_are_close_together_stay_within_the_motors() -> None:
    options = Options("racking", ("none", "racking"), limits="printer", clamp=False)
    _, report = converted(quirk("stops_close_together"), weak("corexy-10000", 15_000.0), options)
    assert report.peaks.belt_acceleration <= 15_000.0


def hardest(chunks: Iterable[Samples]) -> float:
    """Return the greatest acceleration, mm/s², of the motors A = x + y and B = x − y."""
    most = 0.0
    for stretch in stretches(chunks):
        xy = np.concatenate([chunk.commands["racking"] for chunk in stretch])
        most = max(
            most,
            float(np.abs(np.diff(xy @ [[1.0, 1.0], [1.0, -1.0]], n=2, axis=0)).max(initial=0.0)),
        )
    return most / TS**2


@pytest.mark.slow
@pytest.mark.parametrize("limit", [6_000.0, 9_000.0, 15_000.0])
@pytest.mark.parametrize("owner", ["corexy-3000", "corexy-10000", "hbot-3000"])
def test_a_slice_is_compensated_within_any_motors(owner: str, limit: float) -> None:
    """Moves become slower, so that nothing has to be compensated less."""
    options = Options("racking", ("none", "racking"), limits="printer", clamp=False)
    stream = WholeFile(iter(layers("cube.gcode", 5)), weak(owner, limit), options)
    below(hardest(stream.samples()), limit, "acceleration of a motor, mm/s²")
    report = stream.report
    below(report.contour["racking"].rms, 0.3 * report.contour["none"].rms, "RMS error, mm")


@pytest.mark.slow
@pytest.mark.parametrize("limit", [500.0, 2_000.0])
def test_a_slice_is_converted_where_motors_are_far_too_weak(limit: float) -> None:
    options = Options("racking", ("none", "racking"), limits="printer", clamp=True)
    stream = WholeFile(iter(layers("cube.gcode", 5)), weak("corexy-10000", limit), options)
    below(hardest(stream.samples()), limit, "acceleration of a motor, mm/s²")


SETUPS = Path(__file__).parent.parent / "owners"
LAYER = sliced(1)  # of a cube


def set_up(folder: Path, kind: str, acceleration: int) -> Printer:
    """Write answers of a printer with this planner, and the profile that `setup` makes of them."""
    answers = (SETUPS / "marlin500" / "m503.txt").read_text()
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


@pytest.mark.parametrize(
    ("kind", "acceleration"), [("cartesian", 500), ("corexy", 1000), ("cartesian", 3000)]
)
def test_setup_leaves_what_compensation_needs(tmp_path: Path, kind: str, acceleration: int) -> None:
    own = measured(set_up(tmp_path, kind, acceleration), acceleration)
    assert own.limits.acceleration == acceleration
    commands = WholeFile(LAYER, own, Options(clamp=False).resolved(own))  # not yet whole steps
    for _ in commands.samples():
        pass
    contour = commands.report.contour
    below(contour["racking"].rms, 0.25 * contour["none"].rms, "contour error, mm RMS")


def test_motors_that_the_owner_states_get_a_slower_path(tmp_path: Path) -> None:
    own = measured(set_up(tmp_path, "cartesian", 500))
    own = replace(own, motors=replace(own.motors, belt_acceleration=1250.0))
    report = library.convert(LAYER, None, own, Options("racking", ("none", "racking"), clamp=False))
    below(report.peaks.belt_acceleration, 1250.001, "acceleration of a belt, mm/s²")
    below(report.contour["racking"].rms, 0.5 * report.contour["none"].rms, "error, mm RMS")
    assert report.slowed > 0.1
    assert "the limits in [motors] slow down" in report.as_text()
