"""Which model a measurement asks for: modes first, a free rational one where it clearly wins.

Structures are tried from the simplest on. Where several runs were made, a model is judged on runs
that its fit has not seen: each half of them predicts the other. The simplest that predicts about
as well as the best is taken. A printer is modes behind a delay (`modal`); what modes cannot
explain at all is given to a transfer function of freely placed zeros (`rational`), which must
predict the unseen runs far better, as it can also bend itself around what is not linear.

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

from hframe_post.identification import modal, rational
from hframe_post.identification.frequency_response import FrequencyResponse, average
from hframe_post.identification.modal import Modal, Structure
from hframe_post.identification.rational import Rational
from hframe_post.identification.weighting import EXACT, INSIDE, SENSOR, weights

MOST_POLES = 8
PATIENCE = 2  # poles more than the best has, after which no more are tried
AS_GOOD = 1.02  # times the best score, up to which a simpler model is as good
ENOUGH = 0.01  # of a score, in squares of the noise, that says nothing
GOOD = 0.1  # a score below which no better model is looked for
TRIED = 300  # frequencies by which structures are compared; all of them for the result
UNEXPLAINED = 2.0  # residual over noise from which a free rational model is tried
MANY_POLES = 6  # of modes, from which it is tried for a linear printer, too
CLEARLY = 0.5  # of the modes' score, below which it wins elsewhere
FOLLOWS = 0.35  # |G − 1| at half of the band's low end, at most
GAINS = (0.92, 1.08)  # of a sensor; beyond, it is the model that is wrong
DOUBTED = 3.0  # standard deviations of a gain, from which a sensor does not read what is
PLAIN_MODES = 3  # of a printer that is not linear: what is not a mode must not pass for one


@dataclass(frozen=True, slots=True)
class Case:
    """A measurement to be explained. halves: (fitted, predicted) of the runs, if there are two.

    at_rest, band_hz, late, linear, sensor: as `fit` takes them.
    """

    whole: FrequencyResponse
    halves: list[tuple[FrequencyResponse, FrequencyResponse]]
    at_rest: float
    band_hz: tuple[float, float]
    late: tuple[float, float]
    linear: bool
    sensor: tuple[float, float] | None

    @classmethod
    def of(cls, whole: FrequencyResponse, runs: Sequence[FrequencyResponse], *more: Any) -> Case:
        """That of ``whole``, which ``runs`` have in common."""
        halves = [average(runs[::2]), average(runs[1::2])] if len(runs) > 1 else []
        return cls(whole, list(zip(halves, halves[::-1], strict=True)), *more)

    def data(self, part: FrequencyResponse) -> modal.Data:
        """For a fit of modes."""
        late = (self.late[0], self.late[1] + modal.LONGEST_DELAY)
        return modal.Data(part.hz, part.H, weights(part), self.band_hz, late, self.sensor or SENSOR)


def chosen(case: Case, order: int | None) -> Modal | Rational:
    """The model of the measurement. order: poles, None: as many as the data support."""
    found = _best(case, order)
    return found if case.sensor or not case.at_rest else _exact(case, found)


def _best(case: Case, order: int | None) -> Modal | Rational:
    """Modes, or what clearly wins over them."""
    by_modes = _modes(case, order)
    if by_modes is None:
        return _free(case, order)[0]
    best, score = by_modes
    if not case.linear and order is None:
        return best
    many = case.linear and best.structure.order > MANY_POLES
    if many or over(case, best) > UNEXPLAINED:
        free, missed = _free(case, order)
        if missed < (1.0 / AS_GOOD if many else CLEARLY) * score and not _absurd(free, case):
            return free
    return best


def over(case: Case, model: Modal | Rational) -> float:
    """RMS residual in units of the noise."""
    return float(np.sqrt(2.0 * _missed(case.whole, model)))


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
    n = 2 * int((weights(case.whole) > 0.0).sum())
    worse = n * np.log(_missed(case.whole, other) / _missed(case.whole, found))
    return other if worse < DOUBTED**2 and not _absurd(other, case) else found


def _modes(case: Case, order: int | None) -> tuple[Modal, float] | None:
    """The modes that explain the measurement, and their score."""
    whole = case.data(case.whole)
    data = modal.thinned(whole, TRIED)
    found: dict[Structure, Modal] = {}
    scores: dict[Structure, float] = {}
    for structure in modal.structures(case.at_rest == 0.0, order or MOST_POLES):
        if not (case.linear or order or _plain(structure)):
            continue
        if scores and order is None:
            best = min(scores, key=lambda one: scores[one])
            patience = 0 if scores[best] < GOOD else PATIENCE
            if structure.order > best.order + patience:
                break
        found[structure] = modal.fit(data, structure, _simpler(found, structure))
        wanted = order is None or structure.order == order
        if wanted and not _absurd(found[structure], case):
            scores[structure] = _score(case, found[structure])
    if not scores:
        return None
    enough = max(AS_GOOD * min(scores.values()), min(scores.values()) + ENOUGH)
    good = [structure for structure in scores if scores[structure] <= enough]
    chosen = min(good, key=lambda one: (one.unknowns, scores[one]))
    return modal.refined(whole, chosen, found[chosen].place), scores[chosen]


def _plain(structure: Structure) -> bool:
    """Whether it is of modes alone, and few."""
    racks = structure.zeros_at_rest > 0
    few = structure.modes <= PLAIN_MODES and structure.lags == 0
    return few and (racks or not structure.speed)


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
        missed = _missed(case.whole, model)
        return float((missed + ENOUGH) * n ** (model.structure.unknowns / n))
    return float(
        np.mean(
            [
                _missed(
                    other,
                    modal.refined(
                        modal.thinned(case.data(one), TRIED), model.structure, model.place
                    ),
                )
                for one, other in case.halves
            ]
        )
    )


def _missed(response: FrequencyResponse, model: Modal | Rational) -> float:
    error = weights(response) * np.abs(response.H - model.response(response.hz))
    return float((error**2).mean() / 2.0)


def _free(case: Case, order: int | None) -> tuple[Rational, float]:
    """A rational model with free zeros, and its score."""
    found = _rational(case, case.whole, order)
    if not case.halves:
        n = 2 * len(case.whole.hz)
        unknowns = 2 * found.G.order
        return found, float((_missed(case.whole, found) + ENOUGH) * n ** (unknowns / n))
    missed = [_missed(other, _rational(case, one, found.G.order)) for one, other in case.halves]
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
    delay = model.place.delay if isinstance(model, Modal) else model.delay
    hz = np.linspace(0.05, INSIDE * case.band_hz[0], 20)
    followed = model.response(hz) / model.gain * np.exp(2j * np.pi * hz * delay)
    return bool(np.abs(followed - 1.0).max() > FOLLOWS)
