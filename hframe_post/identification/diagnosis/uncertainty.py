"""How well is a model known? Runs and their noise are drawn anew, and the model refined on each.

A bootstrap: of each transfer function DRAWS times as many runs are drawn as there are, some twice
and some not at all, and each frequency gets as much noise again as its coherence tells. How far
the refined models scatter is how far the one that was found may be off. What no drawing tells is
the day: belts and bearings change, so no printer is taken to be known better than to DAILY.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array
from hframe_post.identification.fitting.fit import Fit
from hframe_post.identification.fitting.modal import Data, Modal, refined, thinned
from hframe_post.identification.fitting.weighting import modes_within, weights
from hframe_post.identification.responses.frequency_response import FrequencyResponse, average
from hframe_post.identification.responses.lever_arm import centre, line

DRAWS, SEED = 12, 0
TRIED = 150  # frequencies of each draw
DAILY = 0.05  # relative: what belts, bearings and warmth change from day to day
MOST = 0.2  # relative, beyond which a spread is not a model's
SIGMAS = 2.0


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Standard deviations: of modes' frequencies and dampings (relative), lowest first, with how
    much each mode counts; of the gain (relative)."""

    hz: tuple[float, ...]
    damping: tuple[float, ...]
    counts: tuple[float, ...]
    gain: float

    @property
    def share(self) -> float:
        """By which the printer may differ from the model, as `tune` draws printers."""
        own = [hz * count for hz, count in zip(self.hz, self.counts, strict=True)]
        return min(SIGMAS * max(own, default=0.0), MOST)


def model_uncertainty(
    found: Fit, runs: Sequence[FrequencyResponse], band_hz: tuple[float, float]
) -> Uncertainty | None:
    """Of a model of modes; None of another one, whose roots cannot be told apart so."""
    model = found.model
    if not isinstance(model, Modal):
        return None
    rng = np.random.default_rng(SEED)
    inside = [run.within(band_hz) for run in runs]
    omega, zeta, gain = [], [], []
    for _ in range(DRAWS):
        picked = rng.integers(len(inside), size=len(inside)).tolist()
        part = average([noisy(inside[k], rng) for k in picked])
        about = (model.place.delay - 1e-3, model.place.delay + 1e-3)
        data = thinned(Data(part.hz, part.H, weights(part), modes_within(band_hz), about), TRIED)
        drawn = refined(data, model.structure, model.place)
        omega.append(drawn.place.omega)
        zeta.append(drawn.place.zeta)
        size = float(np.abs(drawn.response(part.hz)) @ np.abs(model.response(part.hz)))
        gain.append(size / float((np.abs(model.response(part.hz)) ** 2).sum()))
    order = np.argsort(model.place.omega)
    counts = (np.abs(model.c) + np.abs(model.d))[order]
    return Uncertainty(
        _relative(np.array(omega)[:, order], model.place.omega[order]),
        _relative(np.array(zeta)[:, order], model.place.zeta[order]),
        tuple((counts / counts.max()).tolist()),
        float(np.std(gain)),
    )


def lever_arm_uncertainty(
    places: Sequence[float], responses: Sequence[FrequencyResponse], Gxx: FrequencyResponse
) -> tuple[float, float]:
    """Standard deviations of x_c (mm) and of racking (relative), by the lever arm."""
    rng = np.random.default_rng(SEED)
    right = line(places, responses).slope
    found, slopes = [], []
    for _ in range(DRAWS):
        drawn = line(places, [noisy(one, rng) for one in responses])
        found.append(centre(drawn, Gxx.H)[0])
        size = (right.power * right.H.conj() * drawn.slope.H).sum().real
        slopes.append(size / (right.power * np.abs(right.H) ** 2).sum())
    return float(np.std(found)), float(np.std(slopes))


def noisy(response: FrequencyResponse, rng: np.random.Generator) -> FrequencyResponse:
    """As it might have been measured."""
    real, imaginary = rng.normal(size=(2, len(response.hz))) * np.sqrt(0.5)
    drawn = response.noise * np.abs(response.H) * (real + 1j * imaginary)
    return replace(response, H=response.H + drawn)


def _relative(drawn: Array, right: Array) -> tuple[float, ...]:
    return tuple((np.std(drawn, axis=0) / right).tolist())
