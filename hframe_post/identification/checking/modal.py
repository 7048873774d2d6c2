"""How the modes of a response drifted: each by itself, behind a delay that stays.

    G' = G_s + e^{−sD}·(M' − M_s)

G_s is the old response at stretched frequencies, and M_s the sum of modes nearest to it. M' are the
same modes as a run shows them: frequency, damping and contribution of each are free. What a sum of
modes does not describe is stretched only. A run does not tell the delay D, so that it is the old
one; how late the nozzle is by damping changes with the modes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import find_peaks

from hframe_post.arrays import TS
from hframe_post.errors import IdentificationError
from hframe_post.identification.checking.run import at_hz, scaling
from hframe_post.identification.estimation.kernel import Mode
from hframe_post.identification.estimation.modes import Modes, described
from hframe_post.identification.responses.frequency_response import FrequencyResponse
from hframe_post.model.impulse_response import ImpulseResponse

HZ = np.arange(6.0, 120.0, 0.5)
PROMINENT = 1.0  # dB; peaks of a response with which the search for modes begins
USUAL_DAMPING = 0.07  # with which it begins
CERTAIN = 0.9999  # coherence of a response that is a model's
EXACT, GAIN = 1e-3, 0.05  # standard deviation of the gain: of a model, and of a sensor
LATEST, NEAR = 5e-3, 1e-3  # s: delay of a model, and how far that of a run is from a rough one
DEGREE = 5  # of the spline through a response


@dataclass(frozen=True, slots=True)
class ModalDrift:
    """A response after its modes drifted. modes: Hz of each before and now, by frequency."""

    G: ImpulseResponse
    modes: tuple[tuple[float, float], ...]


def drifted(G: ImpulseResponse, stretch: float, part: FrequencyResponse, late: float) -> ModalDrift:
    """Return the response whose modes are nearest to what a run shows.

    stretch: of all frequencies, with which the search begins. late: s by which the recording begins
    late, roughly. Modes stay stretched where moving each explains no more than chance would.
    """
    old = _modes(G)
    delay = old.delay / TS

    def at_stretched(one: ImpulseResponse) -> ImpulseResponse:
        return _delayed(one.stretched(stretch), (1.0 - stretch) * delay)

    stretched = _as_long_as(G, at_stretched(G) if not G.elsewhere else G.everywhere(at_stretched))
    modes = replace(old, omega=old.omega / stretch)
    alike = ModalDrift(stretched, _pairs(old, modes))
    H = at_hz(stretched, part.hz)
    shown = replace(part, H=part.H * modes.response(part.hz) / H)
    around = (old.delay + late - NEAR, old.delay + late + NEAR)
    try:
        now = described(shown, _each(modes), around, (1.0, GAIN), speed=False)
    except IdentificationError:
        return alike
    found = _exchanged(stretched, modes, now, delay)
    nearest = scaling(part)
    left, left_now = (nearest(one)[2] for one in (H, at_hz(found, part.hz)))
    if len(now.hz) < len(modes.hz) or not _likelier(left, left_now, len(part.hz), len(now.hz)):
        return alike
    return ModalDrift(found, _pairs(old, now))


def _pairs(old: Modes, now: Modes) -> tuple[tuple[float, float], ...]:
    return tuple(sorted(zip(old.hz.tolist(), now.hz.tolist(), strict=True)))


def _likelier(left: float, left_now: float, frequencies: int, modes: int) -> bool:
    """Return whether three numbers a mode explain more than as many of noise (Akaike)."""
    return bool(2.0 * frequencies * np.log(left / left_now) > 2.0 * 3 * modes)


def _modes(G: ImpulseResponse) -> Modes:
    """Return the sum of modes nearest to a response, with its delay."""
    H = at_hz(G, HZ)
    moving = np.abs(H - 1.0) / HZ**2
    peaks, _ = find_peaks(20.0 * np.log10(np.maximum(moving, 1e-12)), prominence=PROMINENT)
    if not len(peaks):
        peaks = np.array([np.argmax(moving)])
    start = [Mode(2.0 * np.pi * TS * hz, USUAL_DAMPING) for hz in HZ[peaks].tolist()]
    shown = FrequencyResponse(HZ, H, np.full(len(HZ), CERTAIN), 1.0 / HZ**2)
    return described(shown, start, (-LATEST, LATEST), (1.0, EXACT), speed=False)


def _each(modes: Modes) -> list[Mode]:
    return [Mode(w, z) for w, z in zip(modes.omega.tolist(), modes.zeta.tolist(), strict=True)]


def _exchanged(G: ImpulseResponse, old: Modes, new: Modes, delay: float) -> ImpulseResponse:
    """Return a response with other modes behind the same delay, samples."""
    m = len(G.deviation) - G.lead
    before, now = (
        _delayed(ImpulseResponse(one.deviation(m), 0, 1.0, one.lag), delay) for one in (old, new)
    )
    deviation = G.deviation.copy()
    deviation[G.lead :] += now.deviation - before.deviation
    return replace(G, deviation=deviation, lag=G.lag + now.lag - before.lag)


def _as_long_as(G: ImpulseResponse, changed: ImpulseResponse) -> ImpulseResponse:
    """Return a changed response with the lead and the length of the old one."""
    n, first = len(G.deviation), changed.lead - G.lead
    deviation = np.pad(changed.deviation, n)[n + first :][:n]
    return replace(changed, deviation=deviation, lead=G.lead)


def _delayed(G: ImpulseResponse, by: float) -> ImpulseResponse:
    """Return the response later by a part of a sample, as long as before.

    A pulse moves the command by j − lag from sample 0 on, so the deviation is later by as much, and
    the command's own motion until then, lag·by + by²/2 samples², is part of it.
    """
    q, first = G.deviation, -G.lead
    t = np.arange(len(q) + DEGREE) + first
    later = t[: len(q)] - by
    moved = np.asarray(make_interp_spline(t, np.pad(q, (0, DEGREE)), DEGREE)(later))
    moved[later < first] = 0.0
    missed = G.lag * by + by**2 / 2.0
    moved[G.lead : G.lead + 2] += missed / 2.0
    return replace(G, deviation=moved, lag=G.lag + by)
