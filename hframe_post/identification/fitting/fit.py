"""A measurement → its model, with what is to be said of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.fitting import checks, selection
from hframe_post.identification.fitting.modal import Modal
from hframe_post.identification.fitting.rational import Rational
from hframe_post.identification.fitting.selection import MOST_POLES, Case
from hframe_post.identification.fitting.weighting import Distortion
from hframe_post.identification.responses.frequency_response import FrequencyResponse
from hframe_post.model.transfer_function import TransferFunction

OVERDAMPED = 0.99  # damping ratio from which a mode does not ring
UNKNOWN = 5e-5  # s of a delay that noise may leave unknown


@dataclass(frozen=True, slots=True)
class Fit:
    """The transfer function ``G`` and how it was found.

    gain: of the sensor, divided out. recording_delay: s, not part of G. printer_delay: s, part of
    G in addition to its modes, with its bounds. residual: ‖H − Ĥ‖ / ‖H‖ over the band, weighted
    with input power and coherence; residual_over_noise: the same in units of the noise.
    """

    G: TransferFunction
    order: int
    residual: float
    residual_over_noise: float
    gain: float
    recording_delay: float
    printer_delay: float
    printer_delay_bounds: tuple[float, float]
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
        return sorted(checks.natural(pole) for pole in poles)

    def response(self, hz: Array) -> Complex:
        """What is measured, by this model, at ``hz`` (k,): with gain and all delay."""
        return self.model.response(hz)


def fit(
    runs: Sequence[FrequencyResponse],
    whole: FrequencyResponse,
    order: int | None,
    at_rest: float,
    band_hz: tuple[float, float],
    late: tuple[float, float] = (0.0, 0.0),
    distortion: Distortion | None = None,
    sensor: tuple[float, float] | None = None,
) -> Fit:
    """The model of ``whole``, which ``runs`` have in common.

    order: poles, None: as many as the data support. at_rest: 1 for a position, 0 for racking.
    late: bounds (s) of the recordings' own delay. distortion: of ``whole``, by what the sweep's
    harmonics say is not linear. sensor: its gain, mean and standard deviation, where more
    is known of it than that it is a sensor. Raises IdentificationError.
    """
    inside = [run.within(band_hz) for run in runs]
    part = whole.within(band_hz)
    if len(part.hz) < 2 * (order or MOST_POLES) + 2:
        raise IdentificationError(
            f"{len(part.hz)} frequencies in {band_hz[0]:g}–{band_hz[1]:g} Hz are too few to fit"
        )
    left = None
    if distortion is not None:
        inside, part = [distortion.without(run) for run in inside], distortion.without(part)
        left = distortion.left(part.hz)
    case = Case.of(part, inside, at_rest, band_hz, late, left, sensor)
    return _told(case, selection.chosen(case, order))


def _told(case: Case, model: Modal | Rational) -> Fit:
    """The fit, and what is to be said of it."""
    part = case.whole
    w = part.power * part.coherence
    error = np.abs(part.H - model.response(part.hz))
    residual = float(np.sqrt((w * error**2).sum() / (w * np.abs(part.H) ** 2).sum()))
    over = selection.over(case, model)
    if isinstance(model, Modal):
        middle = sum(case.late) / 2.0
        lag = max(model.place.delay - middle, 0.0)
        latest, earliest = (max(model.place.delay - late, 0.0) for late in case.late)
        gain = model.gain if case.at_rest else 1.0
        G = model.discrete(lag, gain)
        order, delay = model.structure.order, model.place.delay - lag
    else:
        G, gain, delay, lag, order = model.G, model.gain, model.delay, 0.0, model.G.order
        earliest = latest = 0.0
    notes, texts = checks.of_zeros(G) if case.at_rest else ((), ())
    if isinstance(model, Rational):
        texts = (*texts, *checks.of_roots(G, case.band_hz))
        texts = (*texts, *checks.of_delay(delay, case.late))
    texts = (*checks.of_order(order, over), *texts)
    lags = (earliest, latest)
    return Fit(G, order, residual, over, gain, delay, lag, lags, model, texts, notes)


def with_gain(found: Fit, gain: float) -> Fit:
    """Racking as a sensor of that gain across measured it."""
    G = replace(found.G, gain=found.G.gain / gain)
    return replace(found, G=G, gain=gain)


def at_one_time(x: Fit, y: Fit) -> tuple[Fit, Fit]:
    """Both axes with the delay that they may have in common, as drivers and belts are alike.

    When a recording began is known to a fraction of its sensor's period only, and the delay of
    recording and printer together far better. What is left of it for the printer is an interval;
    where those of both axes overlap, or nearly so, one delay serves both.
    """
    low, high = (
        choose(one.printer_delay_bounds[k] for one in (x, y)) for k, choose in ((0, max), (1, min))
    )
    if not isinstance(x.model, Modal) or not isinstance(y.model, Modal) or low > high + UNKNOWN:
        return x, y
    lag = (low + high) / 2.0
    return _behind(x, x.model, lag), _behind(y, y.model, lag)


def _behind(found: Fit, model: Modal, lag: float) -> Fit:
    G = model.discrete(lag, found.gain)
    return replace(found, G=G, recording_delay=model.place.delay - lag, printer_delay=lag)
