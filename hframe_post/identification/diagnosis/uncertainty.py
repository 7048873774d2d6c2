"""Uncertainty of a model, by a bootstrap.

From the runs of each transfer function random samples are drawn: as many runs as there are, some of
them twice and some not at all, each with as much noise added as its coherence tells. The model is
refined on each sample, and the scatter is its uncertainty. No sample tells what changes from one
day to the next, so that is assumed (DAY_TO_DAY).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array
from hframe_post.identification.fitting.fit import Fit
from hframe_post.identification.fitting.modal import Data, refine
from hframe_post.identification.fitting.weighting import weights
from hframe_post.identification.responses.frequency_response import FrequencyResponse, average
from hframe_post.identification.responses.lever_arm import centre, line

SAMPLES = 12
DAY_TO_DAY = 0.05  # relative change of a printer as belts, bearings and temperature change
MOST = 0.2  # a model that scatters by more is wrong in another way


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Relative standard deviations of the modes' frequencies and damping, and of the gain.

    Modes are sorted by frequency; importance: size of each mode relative to the largest.
    """

    hz: tuple[float, ...]
    damping: tuple[float, ...]
    importance: tuple[float, ...]
    gain: float

    @property
    def share(self) -> float:
        """Return the relative error of the model (two standard deviations) for `tune`."""
        weighted = [hz * size for hz, size in zip(self.hz, self.importance, strict=True)]
        return min(2.0 * max(weighted, default=0.0), MOST)


def model_uncertainty(
    found: Fit, runs: Sequence[FrequencyResponse], band_hz: tuple[float, float]
) -> Uncertainty:
    """Return the scatter of the model over bootstrap samples of ``runs``."""
    model = found.model
    rng = np.random.default_rng(0)
    inside = [run.within(band_hz) for run in runs]
    omega, zeta, gain = [], [], []
    for _ in range(SAMPLES):
        picked = rng.integers(len(inside), size=len(inside)).tolist()
        part = average([with_noise(inside[k], rng) for k in picked])
        delays = (model.delay - 1e-3, model.delay + 1e-3)
        data = Data(part.hz, part.H, weights(part), model.mode_range_hz, delays).thinned(150)
        refined = refine(data, model.structure, model.parameters)
        omega.append(refined.parameters.omega)
        zeta.append(refined.parameters.zeta)
        size = float(np.abs(refined.response(part.hz)) @ np.abs(model.response(part.hz)))
        gain.append(size / float((np.abs(model.response(part.hz)) ** 2).sum()))
    order = np.argsort(model.parameters.omega)
    sizes = (np.abs(model.c) + np.abs(model.d))[order]
    return Uncertainty(
        _relative(np.array(omega)[:, order], model.parameters.omega[order]),
        _relative(np.array(zeta)[:, order], model.parameters.zeta[order]),
        tuple((sizes / sizes.max()).tolist()),
        float(np.std(gain)),
    )


def lever_arm_uncertainty(
    places: Sequence[float], responses: Sequence[FrequencyResponse], Gxx: FrequencyResponse
) -> tuple[float, float]:
    """Return standard deviations of x_c (mm) and of racking (relative), found by the lever arm."""
    rng = np.random.default_rng(0)
    found = line(places, responses).slope
    centres, slopes = [], []
    for _ in range(SAMPLES):
        sample = line(places, [with_noise(response, rng) for response in responses])
        centres.append(centre(sample, Gxx.H)[0])
        size = (found.power * found.H.conj() * sample.slope.H).sum().real
        slopes.append(size / (found.power * np.abs(found.H) ** 2).sum())
    return float(np.std(centres)), float(np.std(slopes))


def with_noise(response: FrequencyResponse, rng: np.random.Generator) -> FrequencyResponse:
    """Return the response with random noise of the size that its coherence tells."""
    real, imaginary = rng.normal(size=(2, len(response.hz))) * np.sqrt(0.5)
    noise = response.noise * np.abs(response.H) * (real + 1j * imaginary)
    return replace(response, H=response.H + noise)


def _relative(samples: Array, found: Array) -> tuple[float, ...]:
    return tuple((np.std(samples, axis=0) / found).tolist())
