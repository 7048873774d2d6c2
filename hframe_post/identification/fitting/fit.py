"""The model of a measured frequency response, with its warnings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation import known_start, unknown_start
from hframe_post.identification.estimation.estimated import Estimated
from hframe_post.identification.estimation.kernel import Mode
from hframe_post.identification.fitting.modal import Data, Modal, Parameters, Structure, refine
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
    SENSOR,
    Distortion,
    FrequencyResponse,
    advanced,
    average,
    share_left,
    weights,
)
from hframe_post.model.impulse_response import ImpulseResponse, Linear
from hframe_post.model.transfer_function import TransferFunction

RINGS = 0.3  # damping ratio below which a mode visibly rings
# share of the measurement that a response without an assumed mode may leave: of drawn linear
# printers 0.005 to 0.035, of real ones 0.06 to 0.3
LINEAR = 0.05
UNCALIBRATED = (1.0, 0.05)  # gain, as mean and standard deviation, after a rough one
ASSUMED = 0.9995  # coherence of what modes foresee
GAIN_BY_MODES = 0.005  # standard deviation of the gain, if modes explain the recording
EARLY = 4e-3  # s by which the rough start may be late
DESCRIBED = 250  # frequencies, with which modes describe a response
COMPANION = 0.06  # relative distance below which two modes are described as one
LISTED = 0.03  # of the motion at rest: modes that contribute less are not listed
DESCRIBED_LATE = 2e-3  # s by which their delay may differ from the response's lag


@dataclass(frozen=True, slots=True)
class Excited:
    """Responses of one axis where they were excited, on a common delay of nearly 0.

    resonance_hz: of the lowest clear resonance.
    """

    runs: Sequence[FrequencyResponse]
    resonance_hz: float


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
        """Return (Hz, damping ratio) of each mode that rings and counts, lowest first."""
        model = without_rocking(self.model)
        omega, zeta = model.parameters.omega, model.parameters.zeta
        counts = np.hypot(model.c, model.d) > LISTED * abs(model.gain)
        listed = counts & (zeta < RINGS) & (omega <= 2.0 * np.pi * self.highest_hz)
        hz = (omega[listed] / (2.0 * np.pi)).tolist()
        return sorted(zip(hz, zeta[listed].tolist(), strict=True))

    def response(self, hz: Array) -> Complex:
        """Return the model of the measurement at ``hz`` (k,), including gain and all delay."""
        return (self.measured or self.model).response(hz)


def fit_unknown_start(axes: Mapping[str, Excited]) -> dict[str, Fit]:
    """Return the responses of recordings whose start and gain are unknown: all delay is theirs.

    Where a response that begins with its command explains a recording, the printer is late at low
    speed by what the damping of its modes explains, and the rest is the recording's start. Of other
    printers even that is unknown (``unknown_start``). If one axis is of these, all are: they are
    then assumed not to be late, and one of each would pull x and y apart. Raises
    IdentificationError.
    """
    fits = dict[str, Fit]()
    for name, axis in axes.items():
        found = _from_its_damping(axis)
        if found is None:
            return {each: _with_an_ideal_mode(one) for each, one in axes.items()}
        fits[name] = found
    return fits


def _from_its_damping(axis: Excited) -> Fit | None:
    """Return the response that is as late at low speed as the damping of its modes explains.

    None if no linear model explains the recording.
    """
    whole = average(axis.runs)
    gain, late = unknown_start.gain_and_delay(whole)
    late -= EARLY
    scaled = replace(whole, H=whole.H / gain)
    rough = known_start.estimated(advanced(scaled, late), UNCALIBRATED)
    in_time = advanced(scaled, late)
    if share_left(rough.response(whole.hz), in_time, whole.power) > LINEAR:
        return None
    bounds = _about(rough.G.lag * TS, DESCRIBED_LATE)
    seen = whole.hz >= rough.resonance_hz * unknown_start.MEASURED
    model = _in_modes(rough, in_time.where(seen), bounds, UNCALIBRATED, damped=True)
    if not any(mode.zeta < RINGS for mode in rough.modes):  # too stiff to ring, so in time with it
        late += rough.G.lag * TS
        found = known_start.estimated(advanced(scaled, late), UNCALIBRATED)
        return _without_its_frame(
            replace(found, gain=gain * found.gain, delay=late), whole, _about(late)
        )
    late += model.delay
    assumed = advanced(_assumed_below(rough.resonance_hz, in_time, model), model.delay)
    found = known_start.estimated(assumed, (model.gain, GAIN_BY_MODES))
    found = replace(found, gain=gain * found.gain, delay=late)
    fit = _without_its_frame(found, whole, _about(late))
    rocking = fit.rocking or left_below(axis.runs, fit.model, axis.resonance_hz)
    return replace(fit, rocking=rocking) if fit.residual < LINEAR else None


def _assumed_below(
    resonance_hz: float, measured: FrequencyResponse, model: Modal
) -> FrequencyResponse:
    """Return a measured response with that of modes far below the resonance.

    Motion is small there, and what a sensor rounds is wrong in phase and size; modes foresee it.
    """
    low = measured.hz < resonance_hz * unknown_start.MEASURED
    H = np.where(low, model.response(measured.hz), measured.H)
    return replace(measured, H=H, coherence=np.where(low, ASSUMED, measured.coherence))


def response_again(found: Fit, run: FrequencyResponse) -> ImpulseResponse:
    """Return the response of one of the recordings that ``fit_unknown_start`` was made of."""
    if found.measured is None or found.measured.prior is None:
        return unknown_start.estimated(run).G
    assumed = _assumed_below(found.measured.resonance_hz, run, found.model)
    scaled = advanced(replace(assumed, H=assumed.H / found.gain), found.recording_delay)
    return known_start.estimated(scaled, (1.0, GAIN_BY_MODES)).G


def _with_an_ideal_mode(axis: Excited) -> Fit:
    """Return the response that follows its command below the resonance as one mode does."""
    whole = average(axis.runs)
    found = unknown_start.estimated(whole)
    fit = _without_its_frame(found, whole, _about(found.delay))
    return replace(fit, rocking=left_below(axis.runs, fit.model, axis.resonance_hz))


def _about(delay: float, off: float = 1e-5) -> tuple[float, float]:
    return delay - off, delay + off


def _without_its_frame(
    found: Estimated, whole: FrequencyResponse, delay_bounds: tuple[float, float]
) -> Fit:
    """Return the fit of a response, without a frame that rocks.

    delay_bounds: s, of the modes that describe it.
    """
    model = _in_modes(found, whole, delay_bounds, (found.gain, 0.03 * abs(found.gain)))
    G, rocking = found.G, largest_rocking(model)
    if rocking is not None:
        G = _without(G, model, without_rocking(model))
    left = share_left(found.response(whole.hz), whole, whole.power)
    return Fit(
        G, None, left, 1.0, found.gain, found.delay, 0.0, (0.0, 0.0), model, (),
        float(whole.hz[-1]), rocking, found,
    )  # fmt: skip


def fit_known_start(whole: FrequencyResponse, sensor: tuple[float, float] | None) -> Fit:
    """Return the response of recordings whose start is known: all delay is the printer's.

    sensor: mean and standard deviation of its gain, if calibrated. Raises IdentificationError.
    """
    found = known_start.estimated(whole, sensor or SENSOR)
    late = found.G.lag * TS
    fit = _without_its_frame(found, whole, _about(late, DESCRIBED_LATE))
    return replace(fit, printer_delay=late, printer_delay_bounds=(late, late))


def _in_modes(
    found: Estimated,
    whole: FrequencyResponse,
    delay_bounds: tuple[float, float],
    gain: tuple[float, float],
    damped: bool = False,
) -> Modal:
    """Return a sum of modes that describes a response, to show it and to compare runs.

    gain: mean and standard deviation. damped: whether all that is late, but for the delay, is so
    by the damping of the modes.
    """
    modes = list[Mode]()  # without companions of stronger ones, which come first
    for mode in found.modes:
        apart = all(abs(np.log(mode.omega / kept.omega)) > COMPANION for kept in modes)
        if apart and mode.zeta < RINGS:
            modes.append(mode)
    modes = modes or [Mode(2.0 * np.pi * TS * found.resonance_hz, 0.1)]
    omega = np.array([mode.omega / TS for mode in modes])
    zeta = np.array([mode.zeta for mode in modes])
    late = sum(delay_bounds) / 2.0
    data = Data(
        whole.hz, whole.H, weights(whole), (float(whole.hz[0]), float(whole.hz[-1]) * 1.3),
        delay_bounds, gain,
    )  # fmt: skip
    model = refine(
        data.thinned(DESCRIBED), Structure(len(modes), not damped),
        Parameters(omega, zeta, np.zeros(0), late),
    )  # fmt: skip
    found_omega = np.log(model.parameters.omega)
    near = np.abs(found_omega[:, None] - found_omega) < COMPANION
    size = np.hypot(model.c, model.d)
    gone = (near & (size > size[:, None])).any(axis=1)
    if not gone.any():
        return model
    kept = model.without(np.asarray(gone))
    return refine(data.thinned(DESCRIBED), kept.structure, kept.parameters)


def _without(G: ImpulseResponse, model: Modal, kept: Modal) -> ImpulseResponse:
    """Return G without the modes that are in ``model`` but not in ``kept``, and 1 at rest again."""
    whole, rest = (
        ImpulseResponse.from_transfer_function(
            one.discrete(0.0, model.gain), len(G.deviation), one.gain / model.gain
        )
        for one in (model, kept)
    )
    gone = np.roll(whole.deviation - rest.deviation, G.lead)
    gone[: G.lead] = 0.0
    lag = G.lag - whole.lag + rest.lag
    return replace(G, deviation=(G.deviation - gone) / rest.rest, lag=lag / rest.rest)


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
