"""A frame that rocks on its table is measured, reported, and left out of the model."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.arrays import TS
from tests.random_printers import identified, swept
from tests.simulator import Axis, Chip, Machine, Mode


def test_the_mode_of_the_frame_is_reported_and_not_compensated() -> None:
    """What the sensor feels of the frame is no motion of the nozzle over the bed."""
    frame, head = Mode(10.0, 0.02, 0.03), Mode(42.0, 0.06, 0.97)
    rocks, alone = Axis((head, frame), 1e-3), Axis((Mode(42.0, 0.06),), 1e-3)
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
