"""Choice of the model that a measurement supports.

Models are tried from the simplest on. If there are several runs, a model is scored on runs that
its fit has not seen: each half of the runs predicts the other. The simplest model whose score is
about the best is taken.

Up to three searches are made, each more general, until one explains the measurement:

===========  ===========================================================================
simple       few modes, no lags; only where the measurement is distorted
in the band  modes and lags within the measured band
wide         modes up to four times the band, too: the slope of what lies above it
===========  ===========================================================================

What is nonlinear distorts every run alike, so no unseen run tells it from a mode. Harmonics tell
how large the distortion is; then the simplest model that comes as near as that is taken.

A sensor is taken to be exact unless the measurement clearly speaks against it: where a slow pole
explains as much as a gain does, a wrong gain would be a wrong pole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.fitting import modal
from hframe_post.identification.fitting.modal import Data, Modal, Structure
from hframe_post.identification.responses.frequency_response import (
    EXACT,
    NOISE_FLOOR,
    SENSOR,
    FrequencyResponse,
    average,
    mode_range,
    weights,
)

MAX_POLES = 8
TRIED = 300  # frequencies on which structures are compared; the chosen one is refined on all
EXPLAINED = 1.0  # score of a distorted measurement that a better model cannot improve on
CANCELLED = 10.0  # sum of all contributions over the gain above which they only cancel
UNEXPLAINED = 2.0  # RMS residual over noise above which a model misses something


@dataclass(frozen=True, slots=True)
class Case:
    """A measurement to be explained.

    halves: pairs of (fitted, predicted) runs; empty for a single run. distortion: what is not known
    of ``whole`` since it is nonlinear or varies with the position, (k,) relative. The others are
    those of `fit`.
    """

    whole: FrequencyResponse
    halves: list[tuple[FrequencyResponse, FrequencyResponse]]
    racking: bool
    band_hz: tuple[float, float]
    delay_bounds: tuple[float, float]
    distortion: Array | None
    sensor: tuple[float, float] | None

    def data(self, part: FrequencyResponse, mode_range_hz: tuple[float, float]) -> Data:
        """Return the data for a fit; a printer may delay by up to 5 ms.

        A mode far above the band looks like a delay. So that it does not make the printer respond
        before its command, the recording is then taken to start in the middle of its bounds.
        """
        early, late = self.delay_bounds
        if mode_range_hz[1] > self.band_hz[1]:
            early = (early + late) / 2.0
        delays = (early, late + 5e-3)
        sensor = self.sensor or SENSOR
        return Data(part.hz, part.H, self.weights(part), mode_range_hz, delays, sensor)

    def weights(self, part: FrequencyResponse) -> Array:
        """Return one over the standard deviation of H, (k,)."""
        if self.distortion is None:
            return weights(part)
        return weights(part, np.hypot(NOISE_FLOOR, self.distortion))

    def error(self, model: Modal, response: FrequencyResponse) -> float:
        """Return the mean square of the residual in units of the noise."""
        error = self.weights(response) * np.abs(response.H - model.response(response.hz))
        return float((error**2).mean() / 2.0)

    def residual_over_noise(self, model: Modal) -> float:
        """Return the RMS residual in units of the noise."""
        return float(np.sqrt(2.0 * self.error(model, self.whole)))


@dataclass(frozen=True, slots=True)
class Candidate:
    """A model and its score, lower is better.

    score: mean square error on runs that were not fitted, in units of the noise.
    """

    model: Modal
    score: float

    @property
    def structure(self) -> Structure:
        return self.model.structure


def halves(
    runs: Sequence[FrequencyResponse],
) -> list[tuple[FrequencyResponse, FrequencyResponse]]:
    """Return (fitted, predicted) averages of every second run, both ways; empty for one run."""
    if len(runs) < 2:
        return []
    first, second = average(runs[::2]), average(runs[1::2])
    return [(first, second), (second, first)]


def select(case: Case) -> Modal:
    """Return the simplest model that explains the measurement.

    Raises IdentificationError if every model contradicts what printers do.
    """
    low, high = mode_range(case.band_hz) if case.distortion is None else case.band_hz
    searches = [((low, high), False), ((low, 4.0 * high), False)]
    if case.distortion is not None:
        searches = [((low, high), True), ((low, high), False)]
    best: Candidate | None = None
    for mode_range_hz, simple in searches:
        found = _simplest(case, _candidates(case, mode_range_hz, simple))
        if found and (best is None or found.score < _worth(case, best) * best.score):
            best = found
        if best and _explains(case, best):
            break
    if best is None:
        raise IdentificationError(
            "no model of modes explains the frequency response and follows the command at low "
            "frequencies. Check the axis map (--axes) and that the recording belongs to the command"
        )
    known_sensor = case.sensor or case.racking
    return best.model if known_sensor else _with_exact_sensor(case, best.model)


def _refined(case: Case, model: Modal) -> Modal:
    data = case.data(case.whole, model.mode_range_hz)
    return modal.refine(data, model.structure, model.parameters)


def _explains(case: Case, best: Candidate) -> bool:
    if case.distortion is not None:
        return best.score <= EXPLAINED
    return not _strained(best) and case.residual_over_noise(best.model) <= UNEXPLAINED


def _strained(best: Candidate) -> bool:
    """Return whether a model has enough poles that some may describe motion above the band."""
    return best.structure.order > 6


def _worth(case: Case, best: Candidate) -> float:
    """Return the share of the best score that a more general search must reach."""
    return 1.0 / 1.02 if case.distortion is None and _strained(best) else 0.5


def _candidates(case: Case, mode_range_hz: tuple[float, float], simple: bool) -> list[Candidate]:
    """Return models of increasing order, until more poles bring nothing.

    simple: at most three modes, and of a position neither lags nor free speeds.
    """
    data = case.data(case.whole, mode_range_hz).thinned(TRIED)
    good = 0.1 if case.distortion is None else EXPLAINED
    fitted: dict[Structure, Modal] = {}
    candidates: list[Candidate] = []
    for structure in modal.structures(case.racking, MAX_POLES):
        if simple and (structure.modes > 3 or structure.lags):
            continue
        if candidates:
            best = min(candidates, key=lambda candidate: candidate.score)
            if structure.order > best.structure.order + (0 if best.score < good else 2):
                break
        fitted[structure] = _fitted(data, structure, fitted)
        allowed = case.racking or not (simple and structure.speed)
        if allowed and not _impossible(fitted[structure], case):
            candidates.append(Candidate(fitted[structure], _score(case, fitted[structure])))
    return candidates


def _simplest(case: Case, candidates: list[Candidate]) -> Candidate | None:
    """Return the candidate with the fewest unknowns among those about as good as the best, refined.

    What refining makes impossible leaves its place to the next.
    """
    if not candidates:
        return None
    least = min(candidate.score for candidate in candidates)
    enough = max(1.02 * least, least + 0.01)
    if case.distortion is not None:
        enough = max(enough, EXPLAINED)
    ordered = sorted(
        candidates, key=lambda one: (max(one.score, enough), one.structure.unknowns, one.score)
    )
    refined = (replace(one, model=_refined(case, one.model)) for one in ordered)
    return next((one for one in refined if not _impossible(one.model, case)), None)


def _fitted(data: Data, structure: Structure, fitted: dict[Structure, Modal]) -> Modal:
    simpler = [
        model
        for other, model in fitted.items()
        if other.modes + other.lags == structure.modes + structure.lags - 1
        and other.modes <= structure.modes
        and other.lags <= structure.lags
    ]
    start = min(simpler, key=lambda model: model.cost, default=None)
    found = modal.fit(data, structure, start)
    freer = replace(structure, speed=True, zeros_at_rest=min(structure.zeros_at_rest, 1))
    if freer == structure or freer not in fitted:
        return found
    same_modes = modal.refine(data, structure, fitted[freer].parameters)
    return min(found, same_modes, key=lambda model: model.cost)


def _score(case: Case, model: Modal) -> float:
    """Return the mean square error on the unseen half of the runs; of one run by its BIC."""
    if not case.halves:
        n = 2 * len(case.whole.hz)
        unknowns = model.structure.unknowns
        return float((case.error(model, case.whole) + 0.01) * n ** (unknowns / n))
    errors = []
    for seen, unseen in case.halves:
        data = case.data(seen, model.mode_range_hz).thinned(TRIED)
        errors.append(case.error(modal.refine(data, model.structure, model.parameters), unseen))
    return float(np.mean(errors))


def _with_exact_sensor(case: Case, found: Modal) -> Modal:
    """Return the model for an exact sensor, unless that is worse by 3 standard deviations.

    Of normal errors 2N·ln(residual) grows by the square of the gain's standard deviations.
    """
    other = _refined(replace(case, sensor=EXACT), found)
    n = 2 * int((case.weights(case.whole) > 0.0).sum())
    worse = n * np.log(case.error(other, case.whole) / case.error(found, case.whole))
    return other if worse < 3.0**2 and not _impossible(other, case) else found


def _impossible(model: Modal, case: Case) -> bool:
    """Tell whether a model contradicts what every printer and sensor does."""
    if case.racking:
        return False
    if not 0.92 <= model.gain <= 1.08:  # no sensor is that wrong
        return True
    if np.abs(model.coefficients).sum() > CANCELLED * model.gain:
        return True  # the small difference of large motions: far from the truth between the points
    if case.distortion is not None and np.abs(model.c).sum() > 4.0 * model.gain:
        return True  # modes that cancel one another
    # at low frequencies the printer follows its command
    low = np.linspace(0.05, 0.5 * case.band_hz[0], 20)
    hz = model.parameters.omega / (2.0 * np.pi)
    low = np.append(low, hz[hz < case.band_hz[0]])
    followed = model.response(low) / model.gain * np.exp(2j * np.pi * low * model.delay)
    return bool(np.abs(followed - 1.0).max() > 0.35)
