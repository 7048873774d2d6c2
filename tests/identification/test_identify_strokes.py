"""Identification of drawn printers from strokes, as good as from sweeps where they are linear."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import TS
from hframe_post.identification.gather import from_folders
from hframe_post.identification.identify import MeasurementSettings, Run, identify
from hframe_post.identification.recordings.excitation import command_csv
from hframe_post.identification.recordings.known_start import KnownStart
from hframe_post.identification.recordings.strokes import runs
from hframe_post.identification.recordings.sweep import runs as sweeps
from hframe_post.identification.responses.strokes import stroke_responses
from tests.command_line import run as run_command
from tests.quantities import below
from tests.random_printers import BAND, drawn, judged, places, printer, swept
from tests.recordings import write_klipper
from tests.simulator import Chip, Machine

BEGUN, SD = 1234.5, 2e-5  # s of print time, as the simulator has it


def recorded(machine: Machine, chip: Chip, seed: int, seconds: float) -> list[Run]:
    """Return strokes at the default places."""
    made = []
    for k, one in enumerate(runs(printer(machine), seconds=seconds)):
        recording = chip.record(machine, one.command, 100 * seed + k)
        start = KnownStart(BEGUN, SD)
        made.append(Run(one.name, one.command, recording, calibrated=False, start=start))
    return made


def test_the_responses_are_those_of_the_printer_with_its_delay() -> None:
    machine, chip, _ = drawn(4)
    exact = machine.exact()
    (run,) = recorded(machine, chip, 4, 30.0)
    groups = stroke_responses([run], MeasurementSettings(BAND, racks=False))
    for axis, G in enumerate((exact.Gxx, exact.Gyy)):
        found = groups[axis].runs[0]
        omega = 2.0 * np.pi * TS * found.response.hz
        held = G.response(omega) * chip.gains[axis]
        weight = np.sqrt(found.response.power)
        assert found.across is not None
        off, coupled = (
            float(np.linalg.norm(weight * H) / np.linalg.norm(weight * held))
            for H in (found.response.H - held, found.across.H)
        )
        below(off, 0.04, "relative error of the response, 3 to 100 Hz")
        below(coupled, 0.03, "share of a coupling that the printer does not have")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 6])
def test_linear_printers_are_compensated_as_after_a_sweep(seed: int) -> None:
    machine, chip, _ = drawn(seed)
    profile = printer(machine)
    settings = MeasurementSettings(BAND, racks=profile.kinematics.racks)
    by_strokes = identify(recorded(machine, chip, seed, 60.0), settings)
    by_sweep = identify(swept(machine, chip, *places(machine), seed), settings)
    first, second = (
        judged(machine, replace(profile, plant=one.plant(machine.x_c))).compensated
        for one in (by_strokes, by_sweep)
    )
    below(first, 1.05 * second, "error of the rectangle, µm RMS")


def test_a_folder_with_strokes_needs_nothing_else(tmp_path: Path) -> None:
    machine, chip, _ = drawn(4)
    held = tmp_path / "held"
    held.mkdir()
    profile = replace(printer(machine), name="mine")
    (one,) = runs(profile, seconds=20.0)
    (sweep,) = sweeps(profile, 0, [(140.0, 147.5)])
    for run, ended in ((one, f"-t{round(1e6 * (BEGUN + one.seconds))}"), (sweep, "")):
        with (held / f"m.{run.name}.csv").open("wb") as file:
            file.writelines(command_csv(run.command))
        recording = chip.record(machine, run.command, 1)
        write_klipper(held / f"adxl345-{run.name}{ended}.csv", recording)
    gathered = from_folders([held], None, profile.travel)
    assert [each.motion for each in gathered.used] == ["strokes m.measure-at-140.csv"]
    assert [each.reason for each in gathered.aside] == [
        "strokes along the same axis are more like a print"
    ]


@pytest.mark.slow
def test_the_command_line_makes_a_profile_of_strokes(tmp_path: Path) -> None:
    machine, chip, _ = drawn(4)
    (one,) = runs(printer(machine))
    with (tmp_path / f"m.{one.name}.csv").open("wb") as file:
        file.writelines(command_csv(one.command))
    recording = chip.record(machine, one.command, 1)
    write_klipper(tmp_path / f"adxl345-{one.name}.csv", recording)
    held = tmp_path
    done = run_command("identify", "-p", "example-corexy", held, "-o", tmp_path / "new.toml")
    assert done.returncode == 0, done.stderr
    assert b"strokes m.measure-at-140.csv" in done.stdout
