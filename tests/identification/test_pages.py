"""The page of an identification."""

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import TS
from hframe_post.identification.pages import uncertain
from hframe_post.model.impulse_response import ImpulseResponse
from tests.plants import axis_mode

HZ = np.arange(5.0, 100.0, 5.0)


def test_the_band_is_what_drift_and_doubt_make_of_the_response() -> None:
    G = ImpulseResponse.from_transfer_function(axis_mode(40.0, 0.1), 1.0)
    omega = 2.0 * np.pi * TS * HZ
    changed = (G.stretched(1.001).response(omega) - G.response(omega)) / 0.001
    drifts = uncertain(replace(G, drift=0.03), HZ)
    assert drifts == pytest.approx(0.03 * np.abs(changed), rel=0.05)
    both = uncertain(replace(G, drift=0.03, unknown=np.array([0.5])), HZ)
    alone = 0.5 * (2.0 * np.sin(omega / 2.0)) ** 2
    assert both == pytest.approx(np.hypot(drifts, alone), rel=1e-9)
