"""Drawn printers identified from strokes and tests: linear ones as by their exact model."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from hframe_post.arrays import TS
from hframe_post.cli.main import main
from hframe_post.identification.gather import Gathered
from hframe_post.identification.recordings.formats import command_csv
from hframe_post.identification.recordings.strokes import runs
from hframe_post.identification.report import IdentificationReport
from hframe_post.model.plant import Plant
from hframe_post.printer.profile import load
from tests.quantities import below
from tests.random_printers import Errors, drawn, identified, judged, printer, struck
from tests.recordings import write_klipper
from tests.resonance_recordings import MOTIONS, SENSORS, drawn_sensor, linear_printer, runs_of_tests
from tests.simulator import Axis, Chip, Machine, Mode

STEP = 0.0206  # mm of belt
MOVING = 199  # its modes move far as the gantry does
# seeds, s recorded at a place, and the share of the error of the rectangle that is left at most;
# longer where friction, play and the figures of linear ones show better in it
DRAWN = [
    (2, 60.0, 0.05), (6, 60.0, 0.1), (1, 60.0, 0.13), (3, 60.0, 0.12), (5, 20.0, 0.03),
    (7, 20.0, 0.04), (11, 20.0, 0.04), (19, 20.0, 0.1), (MOVING, 20.0, 0.15),
]  # fmt: skip
PLACES = (80.0, 110.0, 140.0, 170.0, 200.0)  # mm of x, of an H-bot that racks


def errors(machine: Machine, plant: Plant) -> Errors:
    """Return the errors of the rectangle on the machine, by that model."""
    return judged(machine, replace(printer(machine), plant=plant))


def as_good_as_exact(machine: Machine, own: Errors) -> None:
    best = errors(machine, machine.exact()).compensated
    below(own.compensated, max(1.3 * best, 1.0), "error of the rectangle, µm RMS")


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "seconds", "share"), DRAWN)
def test_drawn_printers_become_better(seed: int, seconds: float, share: float) -> None:
    """Each fault comes once; linear ones are as good as by their exact model."""
    machine, chip, fault = drawn(seed)
    found = identified(machine, struck(machine, chip, seed, seconds, STEP))
    assert found.refusal is None
    own = errors(machine, plant := found.plant(machine.x_c))
    below(own.compensated, share * own.none, "error of the rectangle, µm RMS")
    if fault == "linear":
        as_good_as_exact(machine, own)
        for axis, gain in zip("xy", chip.gains, strict=False):
            assert found.gains[axis] == pytest.approx(gain, abs=0.01)
    if seed == MOVING:
        text = IdentificationReport(found, plant, None, Gathered([], [])).remarks()
        assert any("cannot describe all of them" in line for line in text)


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


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 8, 18])
def test_resonance_tests_show_modes_and_make_a_printer_as_good_as_its_exact_model(
    seed: int,
) -> None:
    """Each sensor and each motion, and an H-bot.

    Clocks 2 % and gains 10 % off, left-handed mountings, unknown starts.
    """
    machine = linear_printer(seed)
    chip = drawn_sensor(seed, tuple(SENSORS)[seed % 3])
    places = PLACES if machine.kinematics == "hbot" else (140.0,)
    motion = tuple(MOTIONS)[seed // 3 % 3]
    found = identified(machine, runs_of_tests(machine, chip, motion, seed, places, (140.0,)))
    assert found.refusal is None
    for name, axis in (("Gxx", machine.x), ("Gyy", machine.y)):
        modes = [hz for hz, _ in found.fits[name].modes]
        for mode in axis.modes:
            assert min(abs(hz / mode.hz - 1.0) for hz in modes) < 0.01, (name, mode, modes)
    as_good_as_exact(machine, errors(machine, found.plant(machine.x_c)))
