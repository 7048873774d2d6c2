"""How much a model scatters: from sample to sample, and from position to position.

The uncertainty is found by a bootstrap. From the runs of each transfer function random samples are
drawn: as many runs as there are, some of them twice and some not at all, each with as much noise
added as its coherence tells. The model is refined on each sample. No sample tells what changes from
one day to the next, so that is assumed (DAY_TO_DAY).

Modes may change with the gantry's position, since a belt's free length, and with it its stiffness,
changes along x. The model is refined at each position by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from hframe_post.arrays import Array
from hframe_post.identification.fitting.fit import RINGS, Fit
from hframe_post.identification.fitting.modal import Data, Modal, refine
from hframe_post.identification.fitting.rocking import without_rocking
from hframe_post.identification.responses.frequency_response import (
    Distortion,
    FrequencyResponse,
    average,
    weights,
)
from hframe_post.identification.responses.measured import centre, line
from hframe_post.model.transfer_function import TransferFunction

Refit = Callable[[FrequencyResponse], Modal]  # refines a model on another response

SAMPLES = 12
DAY_TO_DAY = 0.05  # relative change of a printer as belts, bearings and temperature change
MOST = 0.2  # a model that scatters by more is wrong in another way
MODE_SCATTER = 0.002  # of a mode from run to run, relative
COUNTED_AS = 4  # positions that this usual scatter is worth


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


def refit(model: Modal, part: FrequencyResponse) -> Modal:
    """Return a model refined on another response; its delay may differ by 1 ms."""
    delays = (model.delay - 1e-3, model.delay + 1e-3)  # modes that shift turn phases, too
    data = Data(part.hz, part.H, weights(part), model.mode_range_hz, delays)
    return refine(data, model.structure, model.parameters)


def session_uncertainty(model: Modal, models: Sequence[Modal]) -> Uncertainty:
    """Return how far the models of single recordings scatter about that of all.

    A mode that hardly rings only shapes the others; its frequency means nothing.
    """
    order = np.argsort(model.parameters.omega)
    omega, zeta = (
        np.array([getattr(one.parameters, name)[order] for one in models])
        for name in ("omega", "zeta")
    )
    sizes = ((np.abs(model.c) + np.abs(model.d)) * (model.parameters.zeta < RINGS))[order]
    gains = [one.gain / model.gain for one in models]
    return Uncertainty(
        _relative(omega, model.parameters.omega[order]),
        _relative(zeta, model.parameters.zeta[order]),
        tuple((sizes / max(sizes.max(), 1e-12)).tolist()),
        float(np.std(gains)),
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


# ---------------------------------------------------------------------- along x


@dataclass(frozen=True, slots=True)
class ModeShift:
    """The mode whose change along x is most certain.

    hz: its frequency at the least and the greatest x (mm) that was measured.
    at_ends: the transfer functions there.
    """

    hz: tuple[float, float]
    x: tuple[float, float]
    at_ends: tuple[TransferFunction, TransferFunction]

    @property
    def message(self) -> str:
        return (
            f"the printer changes along x: a mode at {self.hz[0]:.1f} Hz for x = {self.x[0]:.0f} "
            f"mm lies at {self.hz[1]:.1f} Hz for x = {self.x[1]:.0f} mm"
        )


def position_spread(runs: Sequence[FrequencyResponse]) -> Distortion:
    """Return how far positions differ from their mean, by frequency.

    The mean is known no better than that: modes that shift smear it, and a smeared resonance
    looks like several.
    """
    H = np.array([run.H for run in runs])
    mean = H.mean(axis=0)
    off = np.sqrt((np.abs(H - mean) ** 2).mean(axis=0)) / np.maximum(np.abs(mean), 1e-12)
    return Distortion(runs[0].hz, off.astype(complex), 0.0)


def find_mode_shift(
    found: Fit, places: Sequence[tuple[float, FrequencyResponse]], again: Refit
) -> ModeShift | None:
    """Return how modes shift along x; None if they do not, or fewer than 3 positions tell.

    places: (x in mm, response) of each run. again: refines the model. A shift counts if it is above
    1 % over the positions and has a chance of 0.1 % at most to be noise (Student's t).
    """
    x = np.array([place for place, _ in places])
    if len(places) < 3 or np.ptp(x) == 0.0:
        return None
    model = found.model
    models = [again(response) for _, response in places]
    omega = np.array([one.parameters.omega for one in models])  # (places, modes)
    middle, slope, slope_sd = _lines(x, omega)
    left, right = float(x.min()), float(x.max())
    # an overdamped mode has no frequency to speak of, and a small one does not matter
    size = np.abs(model.c) + np.abs(model.d)
    counts = (size > 0.1 * model.gain) & (model.parameters.zeta < 0.7)
    shifts = np.abs(slope) * (right - left) > 0.01 * middle
    t = np.where(counts & shifts, np.abs(slope) / np.maximum(slope_sd, 1e-12), 0.0)
    k = int(np.argmax(t))
    if t[k] < stats.t.isf(1e-3, len(x) - 2 + COUNTED_AS):
        return None
    ends = [models[int(np.argmin(x))], models[int(np.argmax(x))]]
    ends = [without_rocking(end) for end in ends]
    first, last = (end.discrete(found.printer_delay, end.gain) for end in ends)
    hz = [float((middle[k] + slope[k] * (at - x.mean())) / (2.0 * np.pi)) for at in (left, right)]
    return ModeShift((hz[0], hz[1]), (left, right), (first, last))


def _lines(x: Array, omega: Array) -> tuple[Array, Array, Array]:
    """Fit straight lines through omega (places, modes) over x (places,).

    Return their values at the mean x, slopes, and standard deviations of the slopes. Three places
    lie close to any line by chance, so the scatter that is usual counts, too.
    """
    away = x - x.mean()
    middle, power = omega.mean(axis=0), float(away @ away)
    slope = away @ omega / power
    off = omega - middle - np.outer(away, slope)
    usual = COUNTED_AS * (MODE_SCATTER * middle) ** 2
    variance = (usual + (off**2).sum(axis=0)) / (COUNTED_AS + len(x) - 2)
    return middle, slope, np.sqrt(variance / power)
