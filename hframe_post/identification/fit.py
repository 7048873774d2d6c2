"""Which model a measurement asks for: modes first, a free rational one where it clearly wins.

Structures are tried from the simplest on. Where several runs were made, a model is judged on runs
that its fit has not seen: each half of them predicts the other. The simplest that predicts about
as well as the best is taken. A printer is modes behind a delay (`modal`); what modes cannot
explain at all is given to a transfer function of freely placed zeros (`rational`), which must
predict the unseen runs far better, as it can also bend itself around what is not linear.

A model is refused where it says of low frequencies, at which a printer follows its command,
what no printer does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification import diagnostics, modal, rational
from hframe_post.identification.frequency_response import FrequencyResponse, average
from hframe_post.identification.modal import Modal, Structure
from hframe_post.identification.rational import Rational
from hframe_post.identification.weighting import INSIDE, weights
from hframe_post.model.transfer_function import TransferFunction

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
PLAIN_MODES = 3  # of a printer that is not linear: what is not a mode must not pass for one


@dataclass(frozen=True, slots=True)
class Fit:
    """The transfer function ``G`` and how it was found.

    gain: of the sensor, divided out. delay: s, of the recording, not part of G; lag: s of delay in
    G beside its modes. modes: Hz and damping ratio, lowest first. residual: ‖H − Ĥ‖ / ‖H‖ over
    the band, weighted with input power and coherence; over: the same in units of the noise.
    """

    G: TransferFunction
    order: int
    residual: float
    over: float
    gain: float
    delay: float
    lag: float
    model: Modal | Rational
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def modes(self) -> list[tuple[float, float]]:
        """(Hz, damping ratio) of what rings, lowest first."""
        if isinstance(self.model, Modal):
            place = self.model.place
            pairs = zip(place.omega / (2.0 * np.pi), place.zeta, strict=True)
            return sorted((float(hz), float(zeta)) for hz, zeta in pairs if zeta < OVERDAMPED)
        poles = self.G.poles[self.G.poles.imag > 0.0]
        return sorted(diagnostics.natural(pole) for pole in poles)

    def response(self, hz: Array) -> Complex:
        """What is measured, by this model, at ``hz`` (k,): with gain and all delay."""
        return self.model.response(hz)


OVERDAMPED = 0.99  # damping ratio from which a mode does not ring


@dataclass(frozen=True, slots=True)
class _Case:
    """A measurement to be explained. halves: (fitted, predicted) of the runs, if there are two."""

    whole: FrequencyResponse
    halves: list[tuple[FrequencyResponse, FrequencyResponse]]
    at_rest: float
    band_hz: tuple[float, float]
    late: tuple[float, float]
    linear: bool

    def data(self, part: FrequencyResponse) -> modal.Data:
        """For a fit of modes."""
        late = (self.late[0], self.late[1] + modal.LONGEST_DELAY)
        return modal.Data(part.hz, part.H, weights(part), self.band_hz, late)


def fit(
    runs: Sequence[FrequencyResponse],
    whole: FrequencyResponse,
    order: int | None,
    at_rest: float,
    band_hz: tuple[float, float],
    late: tuple[float, float] = (0.0, 0.0),
    linear: bool = True,
) -> Fit:
    """The model of ``whole``, which ``runs`` have in common.

    order: poles, None: as many as the data support. at_rest: 1 for a position, 0 for racking.
    late: bounds (s) of the recordings' own delay. linear: whether the sweep's harmonics say that
    the printer is, so that free zeros have nothing else to bend around. Raises IdentificationError.
    """
    inside = [run.within(band_hz) for run in runs]
    part = whole.within(band_hz)
    if len(part.hz) < 2 * (order or MOST_POLES) + 2:
        raise IdentificationError(
            f"{len(part.hz)} frequencies in {band_hz[0]:g}–{band_hz[1]:g} Hz are too few to fit"
        )
    halves = [average(inside[::2]), average(inside[1::2])] if len(inside) > 1 else []
    pairs = list(zip(halves, halves[::-1], strict=True))
    case = _Case(part, pairs, at_rest, band_hz, late, linear)
    by_modes = _modes(case, order)
    if by_modes is None:
        return _told(case, _free(case, order)[0])
    best, score = by_modes
    if not linear and order is None:
        return _told(case, best)
    many = linear and best.structure.order > MANY_POLES
    if many or _over(case, best) > UNEXPLAINED:
        free, missed = _free(case, order)
        if missed < (1.0 / AS_GOOD if many else CLEARLY) * score and not _absurd(free, case):
            return _told(case, free)
    return _told(case, best)


def _modes(case: _Case, order: int | None) -> tuple[Modal, float] | None:
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


def _score(case: _Case, model: Modal) -> float:
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


def _over(case: _Case, model: Modal | Rational) -> float:
    """RMS residual in units of the noise."""
    return float(np.sqrt(2.0 * _missed(case.whole, model)))


def _free(case: _Case, order: int | None) -> tuple[Rational, float]:
    """A rational model with free zeros, and its score."""
    settings = (case.at_rest, case.band_hz, case.late)
    found = rational.fit(case.whole, order, *settings)
    if not case.halves:
        n = 2 * len(case.whole.hz)
        unknowns = 2 * found.G.order
        return found, float((_missed(case.whole, found) + ENOUGH) * n ** (unknowns / n))
    missed = [
        _missed(other, rational.fit(one, found.G.order, *settings)) for one, other in case.halves
    ]
    return found, float(np.mean(missed))


def _absurd(model: Modal | Rational, case: _Case) -> bool:
    """Whether no printer is like this."""
    if case.at_rest == 0.0:
        return False
    if not GAINS[0] <= model.gain <= GAINS[1]:
        return True
    delay = model.place.delay if isinstance(model, Modal) else model.delay
    hz = np.linspace(0.05, INSIDE * case.band_hz[0], 20)
    followed = model.response(hz) / model.gain * np.exp(2j * np.pi * hz * delay)
    return bool(np.abs(followed - 1.0).max() > FOLLOWS)


def _told(case: _Case, model: Modal | Rational) -> Fit:
    """The fit, and what is to be said of it."""
    part = case.whole
    w = part.power * part.coherence
    error = np.abs(part.H - model.response(part.hz))
    residual = float(np.sqrt((w * error**2).sum() / (w * np.abs(part.H) ** 2).sum()))
    over = _over(case, model)
    if isinstance(model, Modal):
        middle = sum(case.late) / 2.0
        lag = max(model.place.delay - middle, 0.0)
        gain = model.gain if case.at_rest else 1.0
        G = model.discrete(lag, gain)
        order, delay = model.structure.order, model.place.delay - lag
    else:
        G, gain, delay, lag, order = model.G, model.gain, model.delay, 0.0, model.G.order
    notes, texts = diagnostics.of_zeros(G) if case.at_rest else ((), ())
    if isinstance(model, Rational):
        texts = (*texts, *diagnostics.of_roots(G, case.band_hz))
        texts = (*texts, *diagnostics.of_delay(delay, case.late))
    texts = (*diagnostics.of_order(order, over), *texts)
    return Fit(G, order, residual, over, gain, delay, lag, model, texts, notes)


def with_gain(found: Fit, gain: float) -> Fit:
    """Racking as a sensor of that gain across measured it."""
    G = replace(found.G, gain=found.G.gain / gain)
    return replace(found, G=G, gain=gain)
