"""Drawn printers identified from strokes: linear ones are as good as by their exact model."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from hframe_post.arrays import TS
from hframe_post.cli.main import main
from hframe_post.identification.recordings.formats import command_csv
from hframe_post.identification.recordings.strokes import runs
from hframe_post.printer.profile import load
from tests.quantities import below
from tests.random_printers import drawn, identified, judged, printer, struck
from tests.recordings import write_klipper
from tests.simulator import Axis, Chip, Machine, Mode

STEP = 0.0206  # mm of belt
LINEAR, MOVING = (2, 6), (19,)
FRICTION, PLAY, SECOND, THIRD = 1, 3, 5, 7


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*LINEAR, *MOVING, FRICTION, PLAY, SECOND, THIRD])
def test_drawn_printers_become_better(seed: int) -> None:
    """Each fault comes once; linear ones are as good as by their exact model."""
    machine, chip, fault = drawn(seed)
    found = identified(machine, struck(machine, chip, seed, step=STEP))
    assert found.refusal is None
    profile = printer(machine)
    own = replace(profile, plant=found.plant(machine.x_c))
    error = judged(machine, own)
    assert error.compensated < error.none
    if fault == "linear":
        best = judged(machine, replace(profile, plant=machine.exact())).compensated
        below(error.compensated, max(1.3 * best, 1.0), "error of the rectangle, µm RMS")
        for axis, gain in zip("xy", chip.gains, strict=False):
            assert found.gains[axis] == pytest.approx(gain, abs=0.01)


def test_the_command_line_makes_a_profile_of_strokes(tmp_path: Path) -> None:
    """One axis of a printer that moves its bed, which is soon found."""
    axes = Axis((Mode(40.0, 0.06),)), Axis((Mode(30.0, 0.08),))
    machine, new = Machine(*axes, kinematics="cartesian"), tmp_path / "new.toml"
    one, _ = runs(load("example-cartesian"), seconds=9.0)
    with (tmp_path / f"m.{one.name}.csv").open("wb") as file:
        file.writelines(command_csv(one.command))
    recording = Chip(noise=4.0).record(machine, one.command, 1)
    write_klipper(tmp_path / f"adxl345-{one.name}.csv", recording)
    words = ["identify", "-p", "example-cartesian", str(tmp_path), "-o", str(new)]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    assert f"m.{one.name}.csv" in done.output
    assert "y was not recorded" in done.output
    omega = 2.0 * np.pi * TS * np.arange(10.0, 80.0)
    found, exact = (G.response(omega) for G in (load(str(new)).plant.Gxx, machine.exact().Gxx))
    below(float(np.linalg.norm(found - exact) / np.linalg.norm(exact)), 0.03, "relative error")
