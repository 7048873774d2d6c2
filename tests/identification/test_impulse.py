"""The impulse response of an axis, from what TEST_RESONANCES showed of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hframe_post as hp
from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.fitting.dominant import Excited, share_left
from hframe_post.identification.fitting.fit import fit_response, fit_uncalibrated
from hframe_post.identification.fitting.impulse import estimated
from hframe_post.identification.responses.frequency_response import FrequencyResponse
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.model.shapers import shaper
from tests.modes import axis_mode

# a published CoreXY, x (0) and y (1) on the first day and 18 days later
REAL = Path(__file__).with_name("data") / "corexy_18_days_apart.npz"
HZ = np.arange(5.0, 100.0, 0.125)
AVERAGES = 17.0  # of these recordings, which take 131 s


def real(day: int) -> list[FrequencyResponse]:
    responses = []
    with np.load(REAL) as held:
        for axis in "xy":
            hz, re, im, coherence, power = held[f"{axis}_{day}"].astype(float)
            responses.append(FrequencyResponse(hz, re + 1j * im, coherence, power, AVERAGES))
    return responses


def drawn(gain: float, delay: float, noise: float) -> tuple[FrequencyResponse, Complex]:
    """Return a measured response of two modes, and the true one at HZ."""
    omega = 2.0 * np.pi * TS * HZ
    true = 0.8 * axis_mode(46.0, 0.06).response(omega) + 0.2 * axis_mode(71.0, 0.05).response(omega)
    rng = np.random.default_rng(3)
    off = noise * (rng.normal(size=len(HZ)) + 1j * rng.normal(size=len(HZ))) / np.sqrt(2.0)
    late = np.exp(-2j * np.pi * HZ * delay)
    coherence = np.full(len(HZ), 1.0 / (1.0 + noise**2))
    H = gain * late * true * (1.0 + off)
    return FrequencyResponse(HZ, H, coherence, np.ones(len(HZ)), AVERAGES), true


def test_gain_delay_and_response_are_found() -> None:
    measured, true = drawn(-1.12, 2.3e-3, 0.05)
    found = estimated(measured)
    assert found.gain == pytest.approx(-1.12, rel=0.05)
    assert found.delay == pytest.approx(2.3e-3, abs=2e-4)  # s
    assert found.resonance_hz == pytest.approx(46.0, abs=0.5)
    assert share_left(found.response(HZ), measured, measured.power) < 0.07
    G = found.G.response(2.0 * np.pi * TS * HZ)
    counts = (HZ > 0.42 * 46.0) & (HZ < 95.0)
    off = np.abs(G - true * np.exp(2j * np.pi * HZ * (found.delay - 2.3e-3)) * -1.12 / found.gain)
    assert off[counts].max() < 0.06 * np.abs(true).max()


def test_below_the_resonance_it_is_one_ideal_mode() -> None:
    found = estimated(drawn(1.0, 0.0, 0.05)[0])
    hz = np.arange(0.5, 0.25 * found.resonance_hz, 0.5)
    off = found.G.response(2.0 * np.pi * TS * hz) - 1.0 / (1.0 - (hz / found.resonance_hz) ** 2)
    assert np.abs(off).max() < 2e-3  # of the command
    assert found.G.dc_gain == 1.0


def test_a_test_that_shows_nothing_below_the_resonance_is_refused() -> None:
    measured, _ = drawn(1.0, 0.0, 0.01)
    with pytest.raises(IdentificationError, match="begin the test at a lower frequency"):
        estimated(measured.within((30.0, 95.0)))
    with pytest.raises(IdentificationError, match="too few"):
        estimated(measured.within((30.0, 31.0)))


def test_a_real_printer_keeps_its_response_and_a_sum_of_modes_its_poles() -> None:
    x, _ = real(1)
    found = fit_response(Excited([x], 43.0, 43.0))
    assert isinstance(found.G, ImpulseResponse)
    assert found.order is None
    assert found.residual < fit_uncalibrated(Excited([x], 43.0, 43.0)).residual
    modal = fit_response(Excited([drawn(1.0, 0.0, 0.01)[0]], 46.0, 46.0))
    assert modal.order == 4
    assert modal.measured is None


def contour(G: tuple[ImpulseResponse, ...], commands: tuple[Array, Array], path: Array) -> float:
    """Return the RMS distance (µm) from the path of the nozzle, by convolution, in its middle."""
    nozzle = []
    for response, command in zip(G, commands, strict=True):
        a = np.diff(np.pad(command, 1, mode="edge"), n=2)
        moved = np.convolve(a, response.deviation)[response.lead :][: len(command)]
        nozzle.append(command + moved)
    x, y = np.array(nozzle)
    away = np.abs(np.array([x - path[:, 0].min(), x - path[:, 0].max(),
                            y - path[:, 1].min(), y - path[:, 1].max()])).min(axis=0)  # fmt: skip
    return float(1e3 * np.sqrt((away[500:-500] ** 2).mean()))


def outline(acceleration: float = 10000.0, speed: float = 150.0) -> Array:
    """Return a rectangle of 120 × 20 mm, twice around, each ms, with a stop at every corner."""
    xy = [np.zeros((1000, 2))]
    for dx, dy in [(120.0, 0.0), (0.0, 20.0), (-120.0, 0.0), (0.0, -20.0)] * 2:
        length, ramp = abs(dx) + abs(dy), speed / acceleration
        t = np.arange(0.0, length / speed + ramp, TS)
        v = np.minimum(np.minimum(t, t[-1] - t) * acceleration, speed)
        along = np.cumsum(v) / v.sum()
        xy.append(xy[-1][-1] + along[:, None] * [dx, dy])
    return np.concatenate([*xy, np.tile(xy[-1][-1], (1000, 1))])


def best_shaper(G: ImpulseResponse, path: Array) -> Array:
    """Return the path as the shaper that follows it best on G would shape it."""

    def off(shaped: Array) -> float:
        a = np.diff(np.pad(shaped, 1, mode="edge"), n=2)
        nozzle = shaped + np.convolve(a, G.deviation)[G.lead :][: len(shaped)]
        lags = range(-20, 60)
        return min(float(np.square(np.roll(nozzle, -lag) - path).sum()) for lag in lags)

    found = [
        shaper(name, hz, 0.1) for name in ("zv", "mzv", "ei") for hz in np.arange(27.0, 90.0, 6.0)
    ]
    return min((one.run(path) for one in found), key=off)


@pytest.mark.slow
@pytest.mark.parametrize("first", [1, 2])
def test_one_day_foresees_another_better_than_the_best_shaper(first: int) -> None:
    """Identified on one day, judged by the response of 18 days later or before."""
    known = tuple(estimated(one).G for one in real(first))
    truth = tuple(estimated(one).G for one in real(3 - first))
    path = outline()
    base = hp.load_printer("example-corexy")
    printer = replace(base, plant=Plant(known[0], known[1], None, 0.0), invented=False)
    ours = np.asarray(hp.compensate(path + 50.0, printer, strategy="fbs")) - 50.0
    pad = (len(ours) - len(path)) // 2
    around = np.pad(path, ((pad, pad), (0, 0)), mode="edge")
    shaped = [best_shaper(G, path[:, axis]) for axis, G in enumerate(known)]
    none = contour(truth, (path[:, 0], path[:, 1]), path)
    by_shaper = contour(truth, (shaped[0], shaped[1]), path)
    by_us = contour(truth, (ours[:, 0], ours[:, 1]), around)
    assert by_us < 0.6 * by_shaper, f"{by_us:.1f}, shaper {by_shaper:.1f}, none {none:.1f} µm RMS"
    assert by_us < 0.2 * none
