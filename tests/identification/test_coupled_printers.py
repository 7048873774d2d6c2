"""Printers whose modes move both axes: identified from TEST_RESONANCES, then compensated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import TS, X, Y
from hframe_post.identification.gather import Gathered
from hframe_post.identification.identify import MeasurementSettings, identify
from hframe_post.identification.pages import identification_page
from hframe_post.identification.report import IdentificationReport
from tests.coupled_printers import PLACES, another_day, drawn_coupled, runs_of_days
from tests.identification.test_coupling import Coupled
from tests.identification.test_uncalibrated import coupled_run
from tests.page.pages import data_of
from tests.random_printers import judged, printer
from tests.resonance_recordings import X as ALONG_X
from tests.resonance_recordings import Y as ALONG_Y
from tests.resonance_recordings import drawn_sensor
from tests.simulator import Axis, Machine, Mode

AXIS = Axis((Mode(40.0, 0.1),))  # of no account: only the kinematics are
SETTINGS = MeasurementSettings((3.0, 100.0), racks=False)


@pytest.mark.slow
def test_only_what_two_recordings_share_is_compensated() -> None:
    machine = Coupled((46.0, 33.0), (0.05, 0.08), 0.2, delay=0.0)
    x, again = (coupled_run(machine, ALONG_X, seed=seed) for seed in (1, 2))
    assert not identify([x], SETTINGS).plant(140.0).cross
    found = identify([x, again, coupled_run(machine, ALONG_Y)], SETTINGS)
    (cross,) = found.plant(140.0).cross
    assert (cross.answer, cross.command) == (Y, X)
    hz = np.arange(10.0, 90.0)
    true = machine.response(hz)[:, 1, 0]
    off = np.abs(cross.G.response(2.0 * np.pi * TS * hz) - true)
    assert off.max() < 0.1 * np.abs(true).max()
    report = IdentificationReport(found, found.plant(140.0), None, Gathered([], [], []))
    shown = data_of(identification_page(report, "a printer"))["sections"][2]
    assert shown["title"] == "Coupling: what x does to y"
    labels = [line["label"].split(" at ")[0] for line in shown["charts"][0]["lines"]]
    assert labels == ["recording 1", "recording 2", "compensated"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 6, 11])
def test_compensation_with_couplings_is_better(seed: int) -> None:
    """Recorded on two days, or at three places; the printer has changed since."""
    machine, kind = drawn_coupled(seed)
    racks = machine.kinematics == "hbot"
    places = PLACES if racks or kind == "lever" else (140.0,)
    days = [another_day(machine, k, 0.03) for k in range(2 if len(places) == 1 else 1)]
    runs = runs_of_days(days, drawn_sensor(seed, "adxl345"), seed, places, places)
    found = identify(runs, replace(SETTINGS, racks=racks)).plant(140.0)
    assert found.cross
    profile = printer(Machine(AXIS, AXIS, kinematics=machine.kinematics))
    today = another_day(machine, 9, 0.03)
    with_couplings, without = (
        judged(today, replace(profile, plant=one)).compensated
        for one in (found, replace(found, cross=()))
    )
    assert with_couplings < without
