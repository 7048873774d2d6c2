"""The modes that dominate a real printer's response, from recordings whose gain and start are
unknown.

A real printer is not quite linear and not quite the same on the next day. No linear model explains
all that it does, and a fit that tries to makes modes up. So

 - only what the command excites is fitted; below it the printer follows its command (Prior),
 - modes lie within reach of the resonances that are seen, and ring,
 - every frequency counts by what the best model leaves unexplained, not by the sensor's noise,
 - the simplest model is taken that foresees a recording that it has not seen, or without one the
   only recording, within 5 % as well as the best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.fitting.modal import (
    Data,
    Modal,
    Prior,
    Structure,
    fit,
    refine,
)
from hframe_post.identification.responses.frequency_response import FrequencyResponse, average

MOST_MODES = 4
GAIN = (1.0, 0.3)  # of sensor and excitation together: mean and standard deviation
DAMPING = (0.01, 0.35)
LOWEST = 0.85  # of the lowest clear resonance, above which modes are sought
INDEPENDENT_HZ = 3.0  # frequencies nearer to each other are wrong alike
UNKNOWN = (0.05, 0.005)  # share of the response that is taken as unexplained, at first and at least
AS_GOOD = 1.05  # times the least that is left unexplained, from which a model is good enough
FREQUENCIES = 250  # enough to fit at
REACH = 0.02  # s by which the delay may differ from the rough one


@dataclass(frozen=True, slots=True)
class Excited:
    """Responses of one axis where they were excited, on a common delay of nearly 0.

    resonance_hz: of the lowest clear resonance. lowest_hz: the same of all axes, which may share
    modes.
    """

    runs: Sequence[FrequencyResponse]
    resonance_hz: float
    lowest_hz: float


def dominant_modes(measured: Excited) -> Modal:
    """Return the simplest model that explains the responses. Raises IdentificationError."""
    runs = measured.runs
    if len(runs[0].hz) < 50:
        raise IdentificationError(
            f"only {len(runs[0].hz)} frequencies were excited, too few for a model"
        )
    whole = average(runs)
    data = _data(whole, measured, UNKNOWN[0])
    models = list[Modal]()
    scores = list[float]()
    for modes in range(1, MOST_MODES + 1):
        found = fit(data, Structure(modes, True), models[-1] if models else None)
        models.append(refined(whole, measured, found))
        scores.append(_score(models[-1], measured))
    enough = AS_GOOD * min(scores) + 1e-3
    return models[next(k for k, score in enumerate(scores) if score <= enough)]


def unexplained(model: Modal, response: FrequencyResponse) -> float:
    """Return what a model leaves of a response: RMS of the shares by power and by frequency."""
    H = model.response(response.hz)
    by_power = share_left(H, response, response.power)
    by_frequency = share_left(H, response, 1.0 / np.abs(response.H) ** 2)
    return float(np.sqrt((by_power**2 + by_frequency**2) / 2.0))


def share_left(H: Complex, response: FrequencyResponse, weight: Array) -> float:
    """Return the share of a measured response that H (k,) leaves, whatever their gain and delay."""
    cross = weight * response.H * H.conj()
    late = np.linspace(-5e-3, 5e-3, 201)
    turned = np.exp(2j * np.pi * np.outer(late, response.hz))
    most = float(np.abs((turned @ cross).real).max())
    sizes = (weight * np.abs(H) ** 2).sum() * (weight * np.abs(response.H) ** 2).sum()
    return float(np.sqrt(max(1.0 - most**2 / float(sizes), 0.0)))


def _score(model: Modal, measured: Excited) -> float:
    runs = measured.runs
    if len(runs) == 1:
        return unexplained(model, runs[0])
    pairs = zip(runs, [*runs[1:], runs[0]], strict=True)
    foreseen = [unexplained(refined(seen, measured, model), other) for seen, other in pairs]
    return float(np.mean(foreseen))


def refined(response: FrequencyResponse, measured: Excited, start: Modal) -> Modal:
    """Return the model refined on a response, weighted by what it leaves unexplained itself."""
    share = UNKNOWN[0]
    for _ in range(2):
        start = refine(_data(response, measured, share), start.structure, start.parameters)
        off = np.abs(start.response(response.hz) / response.H - 1.0)
        share = max(float(np.sqrt(np.mean(np.minimum(off, 0.5) ** 2))), UNKNOWN[1])
    return start


def _data(response: FrequencyResponse, measured: Excited, share: float) -> Data:
    hz, H = response.hz, response.H
    size = np.abs(H)
    floor = share * np.hypot(size, 0.4 * np.median(size))
    sd = np.hypot(response.noise * size, floor)
    count = len(hz[:: max(1, len(hz) // FREQUENCIES)])
    independent = (hz[-1] - hz[0]) / INDEPENDENT_HZ
    weight = np.sqrt(min(independent / count, 1.0)) / sd
    highest = 1.2 * max(1.25 * hz[-1], measured.resonance_hz)
    modes = min(max(hz[0], LOWEST * measured.lowest_hz), hz[-1]), highest
    prior = Prior(measured.resonance_hz)
    data = Data(hz, H, weight, modes, (-REACH, REACH), GAIN, DAMPING, prior)
    return data.thinned(FREQUENCIES)
