"""Printers whose modes move both axes: identified from TEST_RESONANCES, then compensated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import TS, X, Y
from hframe_post.identification.identify import Run, Settings, identify
from hframe_post.model.plant import Plant
from tests.coupled_printers import PLACES, another_day, drawn_coupled, runs_of_days
from tests.identification.test_coupling import Coupled
from tests.identification.test_uncalibrated import coupled_run
from tests.random_printers import judged, printer
from tests.resonance_recordings import X as ALONG_X
from tests.resonance_recordings import Y as ALONG_Y
from tests.resonance_recordings import drawn_sensor
from tests.simulator import Axis, Machine, Mode

AXIS = Axis((Mode(40.0, 0.1),))  # of no account: only the kinematics are
SETTINGS = Settings((3.0, 100.0), racks=False)


def plant(*runs: Run) -> Plant:
    return identify(runs, SETTINGS).plant(140.0)


def test_only_what_two_recordings_share_is_written() -> None:
    machine = Coupled((46.0, 33.0), (0.05, 0.08), 0.2, delay=0.0)
    x, y = coupled_run(machine, ALONG_X), coupled_run(machine, ALONG_Y)
    assert not plant(x, y).cross
    again = coupled_run(machine, ALONG_X, seed=2)
    (found,) = plant(x, again, y).cross
    assert (found.answer, found.command) == (Y, X)
    hz = np.arange(10.0, 90.0)
    true = machine.response(hz)[:, 1, 0]
    off = np.abs(found.G.response(2.0 * np.pi * TS * hz) - true)
    assert off.max() < 0.1 * np.abs(true).max()
    changed = coupled_run(replace(machine, angle=-0.1), ALONG_X, seed=3)
    assert not plant(x, changed, y).cross


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
