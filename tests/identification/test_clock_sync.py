"""Drift and start of a sensor's clock: from the two marks, or from windows without marks."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.alignment import acceleration
from hframe_post.identification.recordings.clock_sync import (
    DISPERSION,
    Resampler,
    clock_from_marks,
    clock_from_windows,
    energy_band,
    find_marks,
    moving_samples,
)
from tests.recordings import Sensor, spline, sweep


def resampler(swept: Array, sensor: Sensor) -> Resampler:
    """Return a sensor's recording on a perfectly stiff machine, which has no delay."""
    seconds = (len(swept) - 1) * TS
    recording = sensor.record(spline(swept, 0.0 * swept), seconds)
    rest = recording.a[:500].mean(axis=0)
    return Resampler(recording.t, recording.a - rest)


def test_the_first_and_the_last_equal_stretches_are_the_marks() -> None:
    swept = sweep(rate=30.0)
    command = acceleration(swept)
    marks = find_marks(command, moving_samples(command))
    assert marks is not None
    first, second = (command[at : at + marks.length] for at in (marks.first, marks.second))
    np.testing.assert_allclose(first, second, atol=1e-6 * np.abs(command).max())
    bare = acceleration(sweep(rate=30.0, marks=False))
    assert find_marks(bare, moving_samples(bare)) is None
    other = command.copy()
    other[marks.second : marks.second + marks.length] *= 1.01
    assert find_marks(other, moving_samples(other)) is None


@pytest.mark.parametrize("drift", [-0.01, -0.0003, 0.0, 0.005])
@pytest.mark.parametrize("lead", [0.0, 1.7])
def test_marks_show_drift_and_start(drift: float, lead: float) -> None:
    swept = sweep(rate=20.0)
    command = acceleration(swept)
    marks = find_marks(command, moving_samples(command))
    assert marks is not None
    sensor = resampler(swept, Sensor(drift=drift, lead=lead))
    track = sensor.resampled(0.0, 0.0, int(sensor.seconds / TS) + 1)
    start, found = clock_from_marks(command, marks, track)
    assert found == pytest.approx(drift, abs=1e-5)
    assert start == pytest.approx(lead * (1.0 + drift), abs=5.0 * TS)


@pytest.mark.parametrize("drift", [0.0, 0.008])
def test_windows_show_the_start_and_a_large_drift(drift: float) -> None:
    swept = sweep(rate=4.0, marks=False)
    command = acceleration(swept)
    sensor = resampler(swept, Sensor(drift=drift, lead=2.0))
    start, found = clock_from_windows(command, moving_samples(command), sensor)
    unknown = DISPERSION if drift else 5.0 * TS
    assert abs(found - drift) * len(swept) * TS <= unknown
    assert start == pytest.approx(2.0 * (1.0 + drift), abs=unknown)


def test_a_recording_of_something_else_is_refused() -> None:
    swept = sweep(rate=30.0)
    command = acceleration(swept)
    marks = find_marks(command, moving_samples(command))
    assert marks is not None
    noise = np.random.default_rng(1).normal(0.0, 100.0, (len(command), 3))
    with pytest.raises(IdentificationError, match="that it is of this motion"):
        clock_from_marks(command, marks, noise)


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
