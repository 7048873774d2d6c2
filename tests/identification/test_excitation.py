"""The sweep and its marks: at rest at both ends, within every limit, marks equal bit by bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from hframe_post.arrays import TS, Array
from hframe_post.identification.recordings.excitation import (
    MARK_HZ,
    MARK_SAMPLES,
    amplitude,
    peaks,
    trajectory,
)
from hframe_post.printer.settings import Sweep


@st.composite
def sweeps(draw: st.DrawFn) -> Sweep:
    start = draw(st.floats(0.5, 20.0))
    end = draw(st.floats(start + 5.0, 200.0))
    seconds = draw(st.floats(1.0, 30.0))
    return Sweep(
        start, end, min((end - start) / seconds, end - start), draw(st.floats(100.0, 20000.0)),
        draw(st.floats(0.5, 50.0)), draw(st.floats(0.0, 10.0)), draw(st.floats(0.1, 2.0)),
    )  # fmt: skip


def parts(sweep: Sweep, displacement: Array) -> tuple[Array, Array, Array, list[Array]]:
    """Return the first mark, the sweep, the second mark, and the four rests."""
    quiet = round(sweep.quiet / TS)
    first = quiet + np.arange(MARK_SAMPLES)
    last = len(displacement) - quiet - MARK_SAMPLES + np.arange(MARK_SAMPLES)
    sine = slice(first[-1] + 1 + quiet, last[0] - quiet)
    rests = [
        displacement[:quiet], displacement[first[-1] + 1 : sine.start],
        displacement[sine.stop : last[0]], displacement[last[-1] + 1 :],
    ]  # fmt: skip
    return displacement[first], displacement[sine], displacement[last], rests


@given(sweeps(), st.floats(50.0, 500.0), st.floats(1.0, 100.0))
def test_starts_and_ends_at_rest_within_every_limit(
    sweep: Sweep, speed: float, room: float
) -> None:
    displacement = trajectory(sweep, speed, room)
    d, v, a = peaks(displacement)
    assert d <= min(sweep.stroke + sweep.sway, room) * (1.0 + 1e-9)
    assert v <= speed * (1.0 + 1e-9)
    assert a <= sweep.amplitude * (1.0 + 1e-6)
    first, _, last, rests = parts(sweep, displacement)
    assert first.tobytes() == last.tobytes()
    assert np.abs(first).max() > 0.0
    assert not np.concatenate(rests).any()
    assert all(len(rest) == round(sweep.quiet / TS) for rest in rests)


def test_the_frequency_grows_at_the_rate_and_the_acceleration_has_the_amplitude() -> None:
    """Zero crossings show the frequency, peaks the amplitude, away from both ends."""
    sweep = Sweep(5.0, 100.0, 5.0, 4000.0, sway=0.0)
    _, sine, _, _ = parts(sweep, trajectory(sweep, 1000.0, 1000.0))
    acceleration = np.diff(sine, n=2) / TS**2
    for hz in (20.0, 40.0, 60.0, 80.0):
        middle = round((hz - sweep.start_hz) / sweep.rate_hz_per_s / TS)
        window = acceleration[middle - 250 : middle + 250]
        changes = np.flatnonzero(np.diff(np.sign(window)))
        periods = (len(changes) - 1) / 2.0
        seconds = (changes[-1] - changes[0]) * TS
        assert periods / seconds == pytest.approx(hz, rel=0.01)
        # a second difference sees less of a sine, by sinc² of frequency times TS
        assert np.abs(window).max() == pytest.approx(4000.0 * np.sinc(hz * TS) ** 2, rel=0.01)


def test_speed_and_travel_limit_low_frequencies() -> None:
    sweep = Sweep(1.0, 100.0, 1.0, 5000.0, stroke=20.0, sway=0.0)
    hz = np.array([1.0, 3.0, 80.0])
    w = 2.0 * np.pi * hz
    commanded = amplitude(sweep, hz, 100.0, 8.0)
    assert commanded[0] == pytest.approx(8.0 * w[0] ** 2, rel=0.1)  # travel
    assert commanded[2] == pytest.approx(5000.0, rel=1e-3)
    assert (commanded <= np.minimum(np.minimum(8.0 * w**2, 100.0 * w), 5000.0)).all()
    assert amplitude(sweep, hz, 50.0, 100.0)[1] == pytest.approx(50.0 * w[1], rel=0.1)  # speed


def test_a_mark_is_broad_band() -> None:
    sweep = Sweep()
    mark, *_ = parts(sweep, trajectory(sweep, 300.0, 80.0))
    power = np.abs(np.fft.rfft(np.diff(mark, n=2), 2000)) ** 2
    hz = np.fft.rfftfreq(2000, TS)
    low, high = MARK_HZ
    inside = power[(hz > low + 10.0) & (hz < high - 10.0)]
    assert inside.min() > 0.1 * inside.max()
    assert power[(hz < low / 3.0) | (hz > 1.5 * high)].max() < 0.01 * inside.max()


def gain_error(displacement: Array, step: float) -> float:
    """Return the RMS of gain − 1, 40 to 80 Hz, from a command to its rounding to whole steps."""
    stepped = np.round(displacement / step) * step
    hz, power = signal.welch(displacement, 1.0 / TS, nperseg=4000)
    _, cross = signal.csd(displacement, stepped, 1.0 / TS, nperseg=4000)
    band = (hz >= 40.0) & (hz <= 80.0)
    return float(np.sqrt((np.abs(cross[band] / power[band] - 1.0) ** 2).mean()))


def test_swaying_across_steps_keeps_their_rounding_out_of_the_gain() -> None:
    still, swaying = (
        trajectory(Sweep(30.0, 90.0, 1.0, 5000.0, sway=sway), 300.0, 80.0) for sway in (0.0, 2.0)
    )
    assert gain_error(swaying, 0.02) < gain_error(still, 0.02) / 3.0


@pytest.mark.parametrize(
    ("changed", "cause"),
    [
        ({"end_hz": 1.0}, "end_hz must be above"),
        ({"end_hz": 400.0}, "at most 200"),
        ({"quiet": 0.01}, "quiet must be"),
        ({"rate_hz_per_s": 0.01}, "900 s"),
        ({"rate_hz_per_s": 1000.0}, "between 1 s"),
        ({"start_hz": -1.0}, "above 0"),
        ({"sway": -1.0}, "sway must be"),
        ({"amplitude": float("nan")}, "above 0"),
    ],
)
def test_impossible_sweeps_are_refused(changed: dict[str, Any], cause: str) -> None:
    with pytest.raises(ValueError, match=cause):
        Sweep(**changed)
