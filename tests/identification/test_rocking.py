"""A frame that rocks on its table is measured, reported, and left out of the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import TS
from hframe_post.identification.identify import MeasurementSettings, Run, identify
from hframe_post.identification.recordings.accelerometer import Recording
from tests.random_printers import identified, swept
from tests.resonance_recordings import START, X, klipper, recorded
from tests.simulator import Axis, Chip, Machine, Mode

HEAD, FRAME = Mode(42.0, 0.06, 0.97), Mode(10.0, 0.02, 0.03)


@pytest.mark.slow
def test_the_mode_of_the_frame_is_reported_and_not_compensated() -> None:
    """What the sensor feels of the frame is no motion of the nozzle over the bed."""
    rocks, alone = Axis((HEAD, FRAME), 1e-3), Axis((Mode(42.0, 0.06),), 1e-3)
    machine = Machine(rocks, alone, kinematics="corexy")
    found = identified(machine, swept(machine, Chip(), (140.0,), (140.0,), 1))
    rocking = found.fits["Gxx"].rocking
    assert rocking is not None
    assert (rocking.hz, rocking.damping) == pytest.approx((10.0, 0.02), rel=0.05)
    assert found.fits["Gyy"].rocking is None
    assert [round(hz) for hz, _ in found.fits["Gxx"].modes] == [42]
    low = 2.0 * np.pi * TS * np.linspace(3.0, 14.0, 40)
    over_bed = Machine(alone, alone, kinematics="corexy").exact().Gxx.response(low)
    assert np.abs(found.plant(0.0).Gxx.response(low) - over_bed).max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("on_bed", "shared"),
    [
        (FRAME, True),
        (HEAD, False),
        (None, None),
    ],
)
def test_a_second_sensor_tells_whether_the_bed_rocks_as_well(
    on_bed: Mode | None, shared: bool | None
) -> None:
    axis, alone = Axis((HEAD, FRAME)), Axis((Mode(42.0, 0.06),))
    test = klipper(X, min_freq=6.0, max_freq=65.0, hz_per_sec=2.0)

    def recording(axis: Axis, seed: int) -> Recording:
        machine = Machine(axis, alone, kinematics="corexy")
        return recorded(machine, test, Chip(noise=4.0), 3, seed).recording

    nozzle = recording(axis, 1)
    bed = recording(Axis((replace(on_bed, share=0.03),)), 1) if on_bed else None
    clock = START - float(nozzle.t[0]), 0.0
    run = Run("x", test.command(), nozzle, calibrated=False, rough_clock=clock, second=bed)
    rocking = identify([run], MeasurementSettings((3.0, 60.0), racks=False)).fits["Gxx"].rocking
    assert rocking is not None
    assert rocking.hz == pytest.approx(10.0, rel=0.05)
    assert rocking.shared is shared
