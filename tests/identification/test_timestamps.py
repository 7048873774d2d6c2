"""Time stamps that wander, gaps in them, and samples that are truly uneven."""

import numpy as np
import pytest

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import repaired
from hframe_post.identification.recordings.clock import acceleration, aligned
from tests.recordings import sweep
from tests.resonance_recordings import wandering
from tests.simulator import BEGUN, Chip

SECONDS = 60.0


def oscillator(rate: float) -> Array:
    """Return the true times of a sensor whose rate grows by 200 ppm within the recording."""
    n = np.arange(int(SECONDS * rate))
    t = n / rate
    return np.asarray(t * (1.0 - 1e-4 * t / SECONDS))


def still(t: Array) -> Array:
    return np.zeros((len(t), 3))


@pytest.mark.parametrize("rate", [394.0, 1600.0, 3200.0])
@pytest.mark.parametrize("digits", [4, 6])
def test_stamps_that_wander_give_way_to_even_samples(rate: float, digits: int) -> None:
    true = oscillator(rate)
    stamps = np.round(1234.5 + true + wandering(true, 5e-3), digits)
    assert np.diff(stamps).min() >= 0.0
    t, _, notes = repaired(stamps, still(true))
    off = 1e3 * (t - 1234.5 - true)
    assert np.ptp(1e3 * (stamps - 1234.5 - true)) > 25.0  # ms
    assert np.ptp(off) < 4.0  # ms
    assert np.diff(off).std() < 1e-3  # ms from sample to sample
    assert len(notes) == 1
    assert "time stamps wander by up to" in notes[0]


def test_good_stamps_are_kept() -> None:
    true = oscillator(3200.0)
    stamps = true + wandering(true, 5e-5)
    t, _, notes = repaired(stamps, still(true))
    np.testing.assert_array_equal(t, stamps)
    assert notes == ()


def test_samples_that_are_uneven_are_kept() -> None:
    """A program asks a sensor for its value now and then: the stamps tell when."""
    rng = np.random.default_rng(1)
    stamps = np.cumsum(rng.uniform(1.2e-3, 2.8e-3, 20000)) + 0.0
    t, _, notes = repaired(stamps, still(stamps))
    np.testing.assert_array_equal(t, stamps)
    assert notes == ()


def test_a_gap_among_stamps_that_wander_is_counted_in_samples() -> None:
    """By rounded stamps the period is 2.5 ms, in truth 2.54."""
    true = oscillator(394.0)
    stamps = np.round(true + wandering(true, 1e-3), 4)
    a = np.column_stack([np.sin(2.0 * np.pi * 3.0 * true)] * 3)
    kept = np.ones(len(true), dtype=bool)
    kept[9000:9035] = False
    t, filled, notes = repaired(stamps[kept], a[kept])
    assert len(t) == len(true)
    assert np.ptp(t - true) < 3e-3
    np.testing.assert_allclose(filled[kept], a[kept])
    assert notes[0].startswith("35 samples (0.15 %) are missing; the longest gap is 9")


def test_a_rate_that_bends_is_kept() -> None:
    """An ADXL345 that warms up: 43 ms in (100 s)², and 15 ms more in the last 20 s."""
    t = np.arange(int(130.0 * 371.0)) / 371.0
    stamps = t + 4.3e-6 * t**2 + 15e-3 * np.clip((t - 110.0) / 20.0, 0.0, 1.0) ** 3
    stamps += wandering(t, 5e-6)
    kept, _, notes = repaired(stamps, still(t))
    np.testing.assert_array_equal(kept, stamps)
    assert notes == ()


@pytest.mark.parametrize("drift", [0.0, 0.008])
def test_the_line_of_a_sweep_shows_the_start_and_a_large_drift(drift: float) -> None:
    """On a perfectly stiff machine, which has no delay."""
    swept = sweep()
    recording = Chip(drift=drift, lead=2.0).on_nozzle(swept, 0.0 * swept)
    found = aligned(acceleration(swept[:, None]), recording).clock
    assert found.drift == pytest.approx(drift, abs=5e-5)  # 1.5 ms in all
    assert found.start == pytest.approx(BEGUN, abs=0.02)


def test_a_clock_that_no_sensor_has_is_refused() -> None:
    swept = sweep()
    recording = Chip(drift=0.06, lead=2.0).on_nozzle(swept, 0.0 * swept)
    with pytest.raises(IdentificationError, match=r"to be 6\.0 % wrong, more than the 3 %"):
        aligned(acceleration(swept[:, None]), recording)


@pytest.mark.parametrize("seconds", [2.0, 30.0])
def test_what_draws_no_line_is_refused(seconds: float) -> None:
    """A motion of a moment, and a recording of noise."""
    swept = sweep()
    short = swept[: round(seconds / TS)]
    played = short if seconds < 3.0 else 0.0 * short
    recording = Chip(lead=2.0, noise=60.0).on_nozzle(played, played)
    with pytest.raises(IdentificationError, match=r"explains \d % of it, not 40 %"):
        aligned(acceleration(short[:, None]), recording)
