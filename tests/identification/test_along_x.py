"""A printer whose modes change as the gantry moves."""

from dataclasses import replace

import pytest

from hframe_post.identification.gather import Gathered
from hframe_post.identification.identify import MeasurementSettings, identify
from hframe_post.identification.report import IdentificationReport
from tests.quantities import below
from tests.random_printers import drawn, judged, printer, struck

BAND = (3.0, 100.0)


@pytest.mark.slow
def test_a_printer_whose_modes_move_is_told_so_and_gets_the_model_of_the_middle() -> None:
    seed = 199
    machine, chip, _ = drawn(seed)
    profile = printer(machine)
    found = identify(
        struck(machine, chip, seed, 20.0), MeasurementSettings(BAND, racks=profile.kinematics.racks)
    )
    assert found.refusal is None
    left = judged(machine, replace(profile, plant=found.plant(machine.x_c)))
    below(left.compensated, 0.15 * left.none, "error of the rectangle, µm RMS")
    text = IdentificationReport(found, found.plant(machine.x_c), None, Gathered([], [])).remarks()
    assert any("cannot describe all of them" in line for line in text)
