"""Drift and start of a sensor's clock: from windows of the motion."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.clock import (
    DISPERSION,
    Resampler,
    acceleration,
    clock_from_windows,
    energy_band,
    moving_samples,
)
from tests.recordings import Sensor, spline, sweep


def resampler(swept: Array, sensor: Sensor) -> Resampler:
    """Return a sensor's recording on a perfectly stiff machine, which has no delay."""
    seconds = (len(swept) - 1) * TS
    recording = sensor.record(spline(swept, 0.0 * swept), seconds)
    rest = recording.a[:500].mean(axis=0)
    return Resampler(recording.t, recording.a - rest)


@pytest.mark.parametrize("drift", [0.008])
def test_windows_show_the_start_and_a_large_drift(drift: float) -> None:
    swept = sweep(rate=4.0, marks=False)
    command = acceleration(swept)
    sensor = resampler(swept, Sensor(drift=drift, lead=2.0))
    start, found = clock_from_windows(command, moving_samples(command), sensor)
    unknown = DISPERSION if drift else 5.0 * TS
    assert abs(found - drift) * len(swept) * TS <= unknown
    assert start == pytest.approx(2.0 * (1.0 + drift), abs=unknown)


def test_a_motion_that_is_too_short_for_windows_is_refused() -> None:
    swept = sweep(rate=30.0)
    command = acceleration(swept)
    sensor = resampler(swept, Sensor())
    with pytest.raises(IdentificationError, match="too short"):
        clock_from_windows(command, moving_samples(command)[:300], sensor)


def test_the_band_contains_the_energy() -> None:
    t = np.arange(8000) * TS
    low, high = energy_band(
        np.sin(2.0 * np.pi * 20.0 * t) + np.sin(2.0 * np.pi * 60.0 * t), (0.1, 0.9)
    )
    assert low == pytest.approx(20.0, abs=0.2)
    assert high == pytest.approx(60.0, abs=0.2)
