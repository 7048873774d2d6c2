"""Which model a measurement asks for: modes first, a free rational one where it clearly wins.

Structures are tried from the simplest on. Where several runs were made, a model is judged on runs
that its fit has not seen: each half of them predicts the other. The simplest that predicts about
as well as the best is taken. A printer is modes behind a delay (`modal`); what modes cannot
explain at all is given to a transfer function of freely placed zeros (`rational`), which must
predict the unseen runs far better, as it can also bend itself around what is not linear.

What a printer does that is not linear bends its response as often as it is swept, so no unseen
run tells it from a mode. Its harmonics tell how much of the response that is (`distortion`), and
of a response that is known to that only, the simplest model is taken that is as near: few modes,
inside the band, none of which undoes what another does.

A sensor is taken to read what is unless the measurement says clearly that it does not: where a
slow pole explains as much as a gain does, a wrong gain would be a wrong pole.

A model is refused where it says of low frequencies, at which a printer follows its command,
what no printer does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hframe_post.arrays import Array
from hframe_post.identification.fitting import modal, rational
from hframe_post.identification.fitting.modal import Data, Modal, Structure
from hframe_post.identification.fitting.rational import Rational
from hframe_post.identification.fitting.weighting import (
    EXACT,
    FLOOR,
    INSIDE,
    SENSOR,
    modes_within,
    weights,
)
from hframe_post.identification.responses.frequency_response import FrequencyResponse, average

MOST_POLES = 8
PATIENCE = 2  # poles more than the best has, after which no more are tried
AS_GOOD = 1.02  # times the best score, up to which a simpler model is as good
RACKS_AS_GOOD = 1.1  # the same of racking, which is measured with noise of some per cent
ENOUGH = 0.01  # of a score, in squares of the noise, that says nothing
GOOD = 0.1  # a score below which no better model is looked for
TRIED = 300  # frequencies by which structures are compared; all of them for the result
UNEXPLAINED = 2.0  # residual over noise from which a free rational model is tried
MANY_POLES = 6  # of modes, from which it is tried for a linear printer, too
CLEARLY = 0.5  # of the modes' score, below which it wins elsewhere
FOLLOWS = 0.35  # |G − 1| below the band and at modes of its low end, at most
GAINS = (0.92, 1.08)  # of a sensor; beyond, it is the model that is wrong
DOUBTED = 3.0  # standard deviations of a gain, from which a sensor does not read what is
EXPLAINED = 1.0  # score from which the noise and what is not linear may be all that is missed
PLAIN_MODES = 3  # of a printer that is not linear: what is not a mode must not pass for one
OPPOSED = 4.0  # sum of |c_i| over that of c_i, above which its modes undo one another


@dataclass(frozen=True, slots=True)
class Case:
    """A measurement to be explained. halves: (fitted, predicted) of the runs, if there are two.

    at_rest, band_hz, late, distortion, sensor: as `fit` takes them.
    """

    whole: FrequencyResponse
    halves: list[tuple[FrequencyResponse, FrequencyResponse]]
    at_rest: float
    band_hz: tuple[float, float]
    late: tuple[float, float]
    distortion: Array | None
    sensor: tuple[float, float] | None

    @classmethod
    def of(cls, whole: FrequencyResponse, runs: Sequence[FrequencyResponse], *more: Any) -> Case:
        """That of ``whole``, which ``runs`` have in common."""
        halves = [average(runs[::2]), average(runs[1::2])] if len(runs) > 1 else []
        return cls(whole, list(zip(halves, halves[::-1], strict=True)), *more)

    def data(self, part: FrequencyResponse) -> modal.Data:
        """For a fit of modes."""
        late = (self.late[0], self.late[1] + modal.LONGEST_DELAY)
        lie = modes_within(self.band_hz) if self.distortion is None else self.band_hz
        return modal.Data(part.hz, part.H, self.weights(part), lie, late, self.sensor or SENSOR)

    def weights(self, part: FrequencyResponse) -> Array:
        """One over what is not known of H, (k,)."""
        if self.distortion is None:
            return weights(part)
        return weights(part, np.hypot(FLOOR, self.distortion))


def chosen(case: Case, order: int | None) -> Modal | Rational:
    """The model of the measurement. order: poles, None: as many as the data support."""
    found = _best(case, order)
    return found if case.sensor or not case.at_rest else _exact(case, found)


def _best(case: Case, order: int | None) -> Modal | Rational:
    """Modes, or what clearly wins over them."""
    plain = (
        _modes(case, order, plain=True) if case.distortion is not None and order is None else None
    )
    if plain is not None and plain[1] <= EXPLAINED:
        return plain[0]
    by_modes = _modes(case, order)
    if plain is not None:
        wins = by_modes is not None and by_modes[1] < CLEARLY * plain[1]
        return by_modes[0] if wins and by_modes else plain[0]
    if by_modes is None:
        return _free(case, order)[0]
    best, score = by_modes
    many = case.distortion is None and best.structure.order > MANY_POLES
    if many or over(case, best) > UNEXPLAINED:
        free, missed = _free(case, order)
        if missed < (1.0 / AS_GOOD if many else CLEARLY) * score and not _absurd(free, case):
            return free
    return best


def over(case: Case, model: Modal | Rational) -> float:
    """RMS residual in units of the noise."""
    return float(np.sqrt(2.0 * _missed(case, case.whole, model)))


def _exact(case: Case, found: Modal | Rational) -> Modal | Rational:
    """The same with a sensor that reads what is, unless the measurement speaks against it.

    Of normal errors 2N·ln(residual) grows by the square of the gain's standard deviations.
    """
    sure = replace(case, sensor=EXACT)
    other: Modal | Rational
    if isinstance(found, Modal):
        other = modal.refined(sure.data(case.whole), found.structure, found.place)
    else:
        other = _rational(sure, case.whole, found.G.order)
    n = 2 * int((case.weights(case.whole) > 0.0).sum())
    worse = n * np.log(_missed(case, case.whole, other) / _missed(case, case.whole, found))
    return other if worse < DOUBTED**2 and not _absurd(other, case) else found


def _modes(case: Case, order: int | None, plain: bool = False) -> tuple[Modal, float] | None:
    """The modes that explain the measurement, and their score.

    plain: modes alone, and few, of a position without free speeds.
    """
    racks = case.at_rest == 0.0
    whole = case.data(case.whole)
    data = modal.thinned(whole, TRIED)
    sought = GOOD if case.distortion is None else EXPLAINED
    found: dict[Structure, Modal] = {}
    scores: dict[Structure, float] = {}
    for structure in modal.structures(racks, order or MOST_POLES):
        if plain and (structure.modes > PLAIN_MODES or structure.lags):
            continue
        if scores and order is None:
            best = min(scores, key=lambda one: scores[one])
            patience = 0 if scores[best] < sought else PATIENCE
            if structure.order > best.order + patience:
                break
        found[structure] = _fitted(data, structure, found)
        wanted = order in (None, structure.order) and (racks or not (plain and structure.speed))
        if wanted and not _absurd(found[structure], case):
            scores[structure] = _score(case, found[structure])
    if not scores:
        return None
    least = min(scores.values())
    as_good = RACKS_AS_GOOD if racks else AS_GOOD
    enough = max(as_good * least, least + ENOUGH, 0.0 if case.distortion is None else EXPLAINED)
    good = [structure for structure in scores if scores[structure] <= enough]
    chosen = min(good, key=lambda one: (one.unknowns, scores[one]))
    return modal.refined(whole, chosen, found[chosen].place), scores[chosen]


def _fitted(data: Data, structure: Structure, found: dict[Structure, Modal]) -> Modal:
    """From the best that is simpler by a mode or a lag, and from where the same lie if freer."""
    fitted = modal.fit(data, structure, _simpler(found, structure))
    freer = replace(structure, speed=True, zeros_at_rest=min(structure.zeros_at_rest, 1))
    if freer == structure or freer not in found:
        return fitted
    same = modal.refined(data, structure, found[freer].place)
    return min(fitted, same, key=lambda model: model.cost)


def _simpler(found: dict[Structure, Modal], structure: Structure) -> Modal | None:
    """The best model found with a mode or a lag less."""
    near = [
        model
        for other, model in found.items()
        if (other.modes + other.lags == structure.modes + structure.lags - 1)
        and other.modes <= structure.modes
        and other.lags <= structure.lags
    ]
    return min(near, key=lambda model: model.cost, default=None)


def _score(case: Case, model: Modal) -> float:
    """Mean square of the residual, in units of the noise, on runs that were not fitted.

    Of a single run, what information theory (BIC) makes of its own residual.
    """
    if not case.halves:
        n = 2 * len(case.whole.hz)
        missed = _missed(case, case.whole, model)
        return float((missed + ENOUGH) * n ** (model.structure.unknowns / n))
    return float(
        np.mean(
            [
                _missed(
                    case,
                    other,
                    modal.refined(
                        modal.thinned(case.data(one), TRIED), model.structure, model.place
                    ),
                )
                for one, other in case.halves
            ]
        )
    )


def _missed(case: Case, response: FrequencyResponse, model: Modal | Rational) -> float:
    error = case.weights(response) * np.abs(response.H - model.response(response.hz))
    return float((error**2).mean() / 2.0)


def _free(case: Case, order: int | None) -> tuple[Rational, float]:
    """A rational model with free zeros, and its score."""
    found = _rational(case, case.whole, order)
    if not case.halves:
        n = 2 * len(case.whole.hz)
        unknowns = 2 * found.G.order
        return found, float((_missed(case, case.whole, found) + ENOUGH) * n ** (unknowns / n))
    missed = [
        _missed(case, other, _rational(case, one, found.G.order)) for one, other in case.halves
    ]
    return found, float(np.mean(missed))


def _rational(case: Case, response: FrequencyResponse, order: int | None) -> Rational:
    settings = (case.at_rest, case.band_hz, case.late)
    return rational.fit(response, order, *settings, sensor=case.sensor or SENSOR)


def _absurd(model: Modal | Rational, case: Case) -> bool:
    """Whether no printer is like this."""
    if case.at_rest == 0.0:
        return False
    if not GAINS[0] <= model.gain <= GAINS[1]:
        return True
    hz = np.linspace(0.05, INSIDE * case.band_hz[0], 20)
    if isinstance(model, Modal):
        if case.distortion is not None and float(np.abs(model.c).sum()) > OPPOSED * model.gain:
            return True
        own = model.place.omega / (2.0 * np.pi)
        hz = np.append(hz, own[own < case.band_hz[0]])
    followed = model.response(hz) / model.gain * np.exp(2j * np.pi * hz * model.delay)
    return bool(np.abs(followed - 1.0).max() > FOLLOWS)
