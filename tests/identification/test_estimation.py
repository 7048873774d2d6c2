"""Frequency responses of runs and places, and impulse responses estimated with a kernel."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation import regression
from hframe_post.identification.estimation.frequency_response import (
    FrequencyResponse,
    Spectra,
    average,
    spread,
)
from hframe_post.identification.estimation.measured import (
    Measured,
    MeasurementSettings,
    RunResponse,
)
from hframe_post.identification.estimation.regression import (
    Data,
    Decay,
    Prior,
    regress,
    ringing,
)
from hframe_post.identification.estimation.response import estimated
from hframe_post.identification.places import centre, find_racking, line
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.printer.settings import Printer
from tests.plants import Filter, all_of_them, at, axis_mode, resonant, sweep
from tests.quantities import below

HZ = np.arange(3.0, 100.0, 0.25)
AVERAGES = 8.0


def rad(hz: float) -> float:
    return 2.0 * np.pi * TS * hz


def dense(decay: Decay, k: Array) -> Array:
    apart = np.abs(k[:, None] - k)
    sd = decay.c * np.exp(-decay.beta * np.abs(k))
    return np.asarray(np.outer(sd, sd) * np.exp(-decay.alpha * apart))


def seen(true: Complex, noise: float, seed: int) -> FrequencyResponse:
    """Return a response as measured: with that noise, relative to its RMS."""
    rng = np.random.default_rng(seed)
    sd = noise * np.sqrt(np.mean(np.abs(true) ** 2))
    off = sd * (rng.normal(size=(2, len(HZ))) * np.sqrt(0.5 / AVERAGES))
    H = true + off[0] + 1j * off[1]
    size = np.abs(H) ** 2
    return FrequencyResponse(HZ, H, size / (size + sd**2), np.ones(len(HZ)), AVERAGES)


def two_modes(delay: float, gain: float) -> Complex:
    omega = 2.0 * np.pi * TS * HZ
    both = 0.8 * axis_mode(31.0, 0.08).response(omega) + 0.2 * axis_mode(71.0, 0.05).response(omega)
    return np.asarray(gain * both * np.exp(-2j * np.pi * HZ * delay))


def test_what_decays_without_modes_needs_none() -> None:
    rng = np.random.default_rng(2)
    k = np.arange(-4.0, 200.0)
    q = np.linalg.cholesky(dense(Decay(1.0, 0.03, 0.1), k)) @ rng.normal(size=len(k))
    X = rng.normal(size=(1000, len(k)))
    y = X @ q + 3.0 * rng.normal(size=1000)
    X, y = X / 3.0, y / 3.0
    found = regress(Data.of(X, y, k, np.zeros(0), lambda modes: X @ ringing(k, modes)))
    assert len(found.prior.modes) <= 1
    off = found.response(k) - q
    known = off @ np.linalg.solve(found.known(k), off) / len(k)
    assert 0.4 < known < 1.6  # errors are as large as the posterior says


def test_a_sum_of_modes_is_found_with_gain_and_lag() -> None:
    true = two_modes(1.3e-3, 1.04)
    found = estimated(seen(true, 0.03, 1))
    assert found.prior is not None
    for hz, zeta in ((31.0, 0.08), (71.0, 0.05)):
        near = min(found.prior.modes, key=lambda mode: abs(mode.omega / rad(hz) - 1.0))
        assert near.omega == pytest.approx(rad(hz), rel=0.005)
        assert near.zeta == pytest.approx(zeta, rel=0.1)
    assert len(found.prior.modes) <= 3
    assert found.gain == pytest.approx(1.04, abs=0.005)
    assert found.G.lag == pytest.approx(1.3, abs=0.02)  # ms: these modes have none
    off = np.abs(found.response(HZ) - true)
    below(float(off.max() / np.abs(true).max()), 0.01, "error relative to the peak")
    # what the model says is not known: the standard deviation of Q by frequency
    at = np.exp(-2j * np.pi * TS * np.outer(HZ, np.arange(len(found.G.unknown))))
    sd = np.abs(at @ found.G.unknown) * (2.0 * np.sin(np.pi * TS * HZ)) ** 2
    z = off / (found.gain * np.hypot(sd, 5e-3 / AVERAGES * np.abs(true)))
    assert 0.1 < np.sqrt(np.mean(z**2)) < 3.0


@pytest.mark.slow
def test_what_rings_for_long_is_held_as_long() -> None:
    omega = 2.0 * np.pi * TS * HZ
    true = axis_mode(22.5, 0.035).response(omega)
    found = estimated(seen(true, 0.01, 2))
    off = found.response(HZ) - true
    below(float(np.linalg.norm(off) / np.linalg.norm(true)), 0.005, "relative error")
    assert len(found.G.deviation) > 600
    short = estimated(seen(axis_mode(40.0, 0.1).response(omega), 0.01, 2))
    assert len(short.G.deviation) < 440


def test_a_few_frequencies_are_no_response() -> None:
    with pytest.raises(IdentificationError, match="too few"):
        estimated(seen(two_modes(0.0, 1.0), 0.01, 1).within((30.0, 31.0)))


def test_columns_that_low_noise_leaves_nearly_alike_have_a_posterior() -> None:
    """A motor that is followed exactly, below 100 Hz: most of 440 columns are the others' sum."""
    k, z = np.arange(-4.0, 436.0), np.exp(2j * np.pi * TS * HZ)
    rows = 1e6 * (z - 2.0 + 1.0 / z)[:, None] * z[:, None] ** -k
    X, q = np.concatenate([rows.real, rows.imag]), 5.0 * np.exp(-0.02 * np.abs(k))
    found = regress(
        Data.of(X, X @ q, k, np.zeros(0), lambda modes: np.zeros((len(X), 2 * len(modes)))),
        Prior(Decay(1e3, regression.LEAST.beta, 1e-2)),
    )
    assert np.abs(X @ (found.response(k) - q)).max() < 1e-3 * np.abs(X @ q).max()


BAND = (5.0, 80.0)


def estimate(u: Array, y: Array, band_hz: tuple[float, float] = BAND) -> FrequencyResponse:
    ((found,),) = Spectra.of(u[:, None], y[:, None]).responses(band_hz)
    return found


def flat(H: complex, coherence: float = 1.0, power: float = 1.0) -> FrequencyResponse:
    hz = np.arange(1.0, 101.0)
    one = np.ones(100)
    return FrequencyResponse(hz, np.full(100, H, complex), coherence * one, power * one)


@pytest.mark.parametrize("G", all_of_them())
def test_a_sweep_gives_the_response(G: TransferFunction) -> None:
    u = sweep(4.0)
    part = estimate(u, Filter(G).run(u))
    true = at(G, part.hz)
    assert np.linalg.norm(part.H - true) < 0.002 * np.linalg.norm(true)
    assert part.coherence.min() > 0.99


def test_the_coherence_shows_the_noise() -> None:
    G = resonant(40.0, 0.1)
    u = sweep(4.0)
    noise = 60.0 * np.random.default_rng(1).normal(size=len(u))
    part = estimate(u, Filter(G).run(u) + noise)
    error = np.abs(part.H / at(G, part.hz) - 1.0) / part.noise
    assert 0.7 < np.sqrt(np.mean(error**2)) < 1.4


def test_the_average_trusts_the_coherent_run() -> None:
    good, bad = flat(1.0, 0.999), flat(3.0, 0.1)
    mean = average([good, bad])
    assert np.abs(mean.H - 1.0).max() < 0.01
    assert mean.averages == 2.0


def test_the_coherence_falls_where_runs_differ() -> None:
    assert average([flat(1.0), flat(1.0)]).coherence == pytest.approx(1.0)
    assert average([flat(1.0), flat(-1.0)]).coherence == pytest.approx(0.0, abs=1e-9)
    assert average([flat(1.0), flat(1j)]).coherence == pytest.approx(0.5)


def test_the_spread_is_relative_and_weighted() -> None:
    assert spread([flat(1.0), flat(1.0)]) == pytest.approx(0.0)
    assert spread([flat(0.9), flat(1.1)]) == pytest.approx(0.1)
    assert spread([flat(0.9), flat(1.1, power=0.0)]) == pytest.approx(0.0)


def test_records_that_cannot_be_measurements_are_refused() -> None:
    u = sweep(20.0)
    wrong = [(u[:100], u[:100]), (u, 0.0 * u), (0.0 * u, u)]
    causes = ["too short", "response is zero", "command is zero"]
    for (a, b), cause in zip(wrong, causes, strict=True):
        with pytest.raises(IdentificationError, match=cause):
            estimate(a, b)
    with pytest.raises(IdentificationError, match="same sweep"):
        average([flat(1.0), flat(1.0).within(BAND)])


PLACES = [80.0, 110.0, 140.0, 170.0, 200.0]


def response(H: Complex, noise: float = 1e-30) -> FrequencyResponse:
    """Return a response. noise: power that the command does not explain, per its power."""
    signal = np.abs(H) ** 2
    return FrequencyResponse(HZ, H, signal / (signal + noise), np.ones(len(HZ)))


def responses_across(paper: Printer, x_c: float, psi: float) -> list[Complex]:
    plant, omega = paper.plant, 2.0 * np.pi * TS * HZ
    assert plant.Gxtheta is not None
    racking, x = plant.Gxtheta.response(omega), plant.Gxx.response(omega)
    return [(place - x_c) * racking + psi * x for place in PLACES]


@given(x_c=st.floats(50.0, 250.0), psi=st.floats(-0.1, 0.1))
def test_slope_centre_and_rotation_are_found(paper: Printer, x_c: float, psi: float) -> None:
    omega = 2.0 * np.pi * TS * HZ
    assert paper.plant.Gxtheta is not None
    fitted = line(PLACES, [response(H) for H in responses_across(paper, x_c, psi)])
    np.testing.assert_allclose(fitted.slope.H, paper.plant.Gxtheta.response(omega), atol=1e-12)
    found = centre(fitted, paper.plant.Gxx.response(omega))
    assert found == pytest.approx((x_c, psi), abs=1e-6)
    assert fitted.off < 1e-9


def test_each_place_but_the_middle_shows_the_slope(paper: Printer) -> None:
    fitted = line(PLACES, [response(H) for H in responses_across(paper, 140.0, 0.02)])
    assert [place for place, _ in fitted.by_place] == [80.0, 110.0, 170.0, 200.0]
    for _, alone in fitted.by_place:
        np.testing.assert_allclose(alone.H, fitted.slope.H, atol=1e-12)


def test_exchanged_places_are_off_the_line(paper: Printer) -> None:
    responses = [response(H) for H in responses_across(paper, 140.0, 0.0)]
    responses[0], responses[4] = responses[4], responses[0]
    assert line(PLACES, responses).off > 1.0
    runs = [
        RunResponse(at, flat(1.0).within(BAND), one)
        for at, one in zip(PLACES, responses, strict=True)
    ]
    with pytest.raises(IdentificationError, match="files of two places exchanged"):
        find_racking(Measured.of(runs), {}, MeasurementSettings(BAND))


def test_noise_of_the_slope_follows_from_that_of_the_places(paper: Printer) -> None:
    noise, rng = 1e-4, np.random.default_rng(0)
    clean = responses_across(paper, 140.0, 0.0)
    assert paper.plant.Gxtheta is not None
    true = paper.plant.Gxtheta.response(2.0 * np.pi * TS * HZ)
    off = []
    for _ in range(20):
        errors = rng.normal(0.0, np.sqrt(noise / 2.0), (len(PLACES), len(HZ), 2)) @ [1.0, 1.0j]
        shown = [response(H + e, noise) for H, e in zip(clean, errors, strict=True)]
        one = line(PLACES, shown)
        assert one.off > 0.0 == one.beyond_noise, "what noise explains is no exchange"
        off.append(np.abs(one.slope.H - true) ** 2)
    fitted = line(PLACES, [response(H, noise) for H in clean]).slope
    expected = (1.0 / fitted.coherence - 1.0) * np.abs(fitted.H) ** 2
    assert np.mean(off) == pytest.approx(np.mean(expected), rel=0.1)
