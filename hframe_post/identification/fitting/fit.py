"""The model of a measured frequency response, with its warnings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.fitting.dominant import Excited, dominant_modes, share_left
from hframe_post.identification.fitting.impulse import Estimated, estimated
from hframe_post.identification.fitting.modal import Modal
from hframe_post.identification.fitting.rocking import (
    Rocking,
    largest_rocking,
    left_below,
    without_rocking,
)
from hframe_post.identification.fitting.selection import (
    MAX_POLES,
    UNEXPLAINED,
    Case,
    halves,
    select,
)
from hframe_post.identification.responses.frequency_response import (
    Distortion,
    FrequencyResponse,
    average,
)
from hframe_post.model.impulse_response import Linear
from hframe_post.model.transfer_function import TransferFunction

RINGS = 0.3  # damping ratio below which a mode visibly rings
MODAL = (
    0.045  # share of the measurement; of sums of modes 0 to 0.035, of real printers 0.06 to 0.09
)


@dataclass(frozen=True, slots=True)
class Fit:
    """The response ``G`` and how it was found.

    order: poles without those of the delay; None if G is an impulse response, ``measured``, and
    the modes of ``model`` only describe it. residual: ‖H − Ĥ‖ / ‖H‖ over the band, weighted with
    input power and coherence; residual_over_noise: the same in units of the noise. gain: of the
    sensor, not part of G. recording_delay: s, not part of G. printer_delay: s, part of G, with
    its bounds. highest_hz: up to which modes were measured. rocking: of the frame, not part of G.
    """

    G: Linear
    order: int | None
    residual: float
    residual_over_noise: float
    gain: float
    recording_delay: float
    printer_delay: float
    printer_delay_bounds: tuple[float, float]
    model: Modal
    warnings: tuple[str, ...]
    highest_hz: float = np.inf
    rocking: Rocking | None = None
    measured: Estimated | None = None

    @property
    def modes(self) -> list[tuple[float, float]]:
        """Return (Hz, damping ratio) of each mode that rings, lowest first."""
        parameters = without_rocking(self.model).parameters
        pairs = zip(parameters.omega / (2.0 * np.pi), parameters.zeta, strict=True)
        rings = [(float(hz), float(z)) for hz, z in pairs if z < RINGS and hz <= self.highest_hz]
        return sorted(rings)

    def response(self, hz: Array) -> Complex:
        """Return the model of the measurement at ``hz`` (k,), including gain and all delay."""
        return (self.measured or self.model).response(hz)


def fit_response(measured: Excited) -> Fit:
    """Return the response of recordings whose start and gain are unknown: all delay is theirs.

    It is an impulse response if modes miss more than MODAL that this explains. Raises
    IdentificationError.
    """
    found, whole = fit_uncalibrated(measured), average(measured.runs)
    try:
        response = estimated(whole)
    except IdentificationError:  # nothing was excited below the resonance, which modes do not need
        return found
    residual = share_left(response.response(whole.hz), whole, whole.power)
    if found.residual**2 - residual**2 <= MODAL**2:
        return found
    return replace(
        found, G=response.G, order=None, residual=residual, gain=response.gain,
        recording_delay=response.delay, measured=response,
    )  # fmt: skip


def fit(
    runs: Sequence[FrequencyResponse],
    whole: FrequencyResponse,
    racking: bool,
    band_hz: tuple[float, float],
    delay_bounds: tuple[float, float] = (0.0, 0.0),
    distortion: Distortion | None = None,
    sensor: tuple[float, float] | None = None,
) -> Fit:
    """Return the model of ``whole``, the mean of ``runs``.

    racking: whether it is 0 at rest, not a position, which is 1. delay_bounds: of the recording, s.
    distortion: of ``whole``, by what is nonlinear. sensor: mean and standard deviation of its gain,
    if calibrated. Raises IdentificationError.
    """
    inside = [run.within(band_hz) for run in runs]
    part = whole.within(band_hz)
    if len(part.hz) < 2 * MAX_POLES + 2:
        raise IdentificationError(
            f"{len(part.hz)} frequencies in {band_hz[0]:g}–{band_hz[1]:g} Hz are too few to fit. "
            "Choose a wider --band"
        )
    remaining = None
    if distortion is not None:
        inside = [distortion.removed_from(run) for run in inside]
        part = distortion.removed_from(part)
        remaining = distortion.remaining(part.hz)
    case = Case(part, halves(inside), racking, band_hz, delay_bounds, remaining, sensor)
    return _described(case, select(case))


def fit_uncalibrated(measured: Excited) -> Fit:
    """Return the model of recordings whose start and gain are unknown: all delay is theirs.

    Their noise is not what limits the fit, so ``residual_over_noise`` is 1. Raises
    IdentificationError.
    """
    model, whole = dominant_modes(measured), average(measured.runs)
    residual = share_left(model.response(whole.hz), whole, whole.power)
    G, order = model.discrete(0.0, model.gain), model.structure.order
    rocking = left_below(measured.runs, model, measured.resonance_hz)
    return Fit(
        G, order, residual, 1.0, model.gain, model.delay, 0.0, (0.0, 0.0), model, (),
        float(whole.hz[-1]), rocking,
    )  # fmt: skip


def _described(case: Case, model: Modal) -> Fit:
    part = case.whole
    w = part.power * part.coherence
    error = np.abs(part.H - model.response(part.hz))
    residual = float(np.sqrt((w * error**2).sum() / (w * np.abs(part.H) ** 2).sum()))
    over = case.residual_over_noise(model)
    middle = sum(case.delay_bounds) / 2.0
    printer_delay = max(model.delay - middle, 0.0)
    latest, earliest = (max(model.delay - bound, 0.0) for bound in case.delay_bounds)
    gain = 1.0 if case.racking else model.gain
    kept = without_rocking(model)
    G = kept.discrete(printer_delay, 1.0 if case.racking else kept.gain)
    order = kept.structure.order
    warnings = check_order(order, over)
    return Fit(
        G, order, residual, over, gain, model.delay - printer_delay, printer_delay,
        (earliest, latest), model, tuple(warnings), rocking=largest_rocking(model),
    )  # fmt: skip


def with_gain(racking: Fit, gain: float) -> Fit:
    """Return racking for a sensor that reads ``gain`` along the axis across."""
    assert isinstance(racking.G, TransferFunction)
    G = replace(racking.G, gain=racking.G.gain / gain)
    return replace(racking, G=G, gain=gain)


def with_common_delay(x: Fit, y: Fit) -> tuple[Fit, Fit]:
    """Return both axes with one printer delay, if they may have it in common.

    Drivers and belts of both axes are alike. The start of a recording is known to a fraction of
    the sensor's period only, but the delay of recording and printer together far better. This
    leaves an interval for the printer's delay. If the intervals of both axes overlap within 0.05
    ms, which noise may hide, the middle of the overlap is the delay of both.
    """
    low = max(x.printer_delay_bounds[0], y.printer_delay_bounds[0])
    high = min(x.printer_delay_bounds[1], y.printer_delay_bounds[1])
    if low > high + 5e-5 or x.measured or y.measured:
        return x, y
    delay = (low + high) / 2.0
    return _with_delay(x, delay), _with_delay(y, delay)


def _with_delay(found: Fit, delay: float) -> Fit:
    kept = without_rocking(found.model)
    G = kept.discrete(delay, kept.gain)
    rest = found.model.delay - delay
    return replace(found, G=G, recording_delay=rest, printer_delay=delay)


def check_order(order: int, residual_over_noise: float) -> list[str]:
    """Return a warning if the noise does not explain the residual.

    Of linear printers the residual is 1.6 times the noise at most.
    """
    if residual_over_noise <= UNEXPLAINED:
        return []
    return [
        f"a model of order {order} leaves {residual_over_noise:.1f} times what the noise explains: "
        "the printer has more resonances, or is not linear"
    ]
