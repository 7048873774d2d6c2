"""Frequency responses against the transfer functions that made the samples."""

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation.frequency_response import (
    FrequencyResponse,
    Spectra,
    average,
    spread,
)
from hframe_post.model.transfer_function import TransferFunction
from tests.plants import Filter, all_of_them, at, resonant, sweep

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
