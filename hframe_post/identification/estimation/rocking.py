"""The frame that rocks on its table: measured, but not compensated.

The reaction of a moving head shakes the whole machine on its feet. A sensor on the nozzle feels it
as a light mode far below the others; but nozzle and bed move together, so it does not show in a
print. A command that cancelled it would.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, Complex, Flags
from hframe_post.identification.estimation.kernel import Mode
from hframe_post.identification.estimation.known_start import AFTER
from hframe_post.identification.estimation.modes import Modes
from hframe_post.identification.responses.frequency_response import FrequencyResponse
from hframe_post.model.impulse_response import ImpulseResponse

BELOW = 1.0 / 3.0  # of the strongest mode's frequency
LIGHT = 0.2  # of the motion at rest, and a greater damping ratio than frames on feet have
SHARED = 0.4  # of the response, that the bed has at least if the whole printer rocks
VISIBLE = 0.15  # of the response, from which a peak is reported
SAME = 0.05  # relative distance of two frequencies of one mode


@dataclass(frozen=True, slots=True)
class Rocking:
    """A light mode far below the others.

    share: of the response at its peak. shared: whether a second sensor, on the bed, moves as well;
    None without one.
    """

    hz: float
    damping: float
    share: float
    shared: bool | None = None

    def message(self, axis: str) -> str:
        seen = (
            f"{axis}: something resonates at {self.hz:.1f} Hz with {100 * self.share:.0f} % of the "
            "motion"
        )
        if self.shared is None:
            return (
                f"{seen}, probably the whole printer rocking on its table. Nozzle and bed move "
                "together then, so the profile does not compensate it. A second sensor, on the "
                "bed, would prove it"
            )
        if self.shared:
            return (
                f"{seen}, and so does the second sensor: the whole printer rocks on its table. "
                "Nozzle and bed move together, so the profile does not compensate it"
            )
        return (
            f"{seen}, which the second sensor does not show: it is not the printer rocking on its "
            "table. The profile does not compensate it; look for what is loose on the head"
        )

    def compared(self, hz: Array, second: Array) -> Rocking:
        """Return the same with what a second sensor tells by its response (k,) at hz (k,)."""
        near = np.abs(hz / self.hz - 1.0) < 0.1
        return replace(self, shared=bool(second[near].max(initial=0.0) > SHARED * self.share))


def rocking_flags(modes: Modes) -> Flags:
    """Flag the modes (n,) that are the frame's: light, and far below the strongest."""
    strongest = modes.omega[np.argmax(modes.sizes)]
    light = (modes.sizes < LIGHT) & (modes.zeta < LIGHT)
    return np.asarray(light & (modes.omega < BELOW * strongest))


def largest(modes: Modes) -> Rocking | None:
    """Return the mode of the frame that shows most, if any is the frame's."""
    flags = rocking_flags(modes)
    if not flags.any():
        return None
    share = np.where(flags, modes.sizes / (2.0 * modes.zeta), 0.0)
    k = int(np.argmax(share))
    return Rocking(float(modes.hz[k]), float(modes.zeta[k]), float(share[k]))


def without_frame(G: ImpulseResponse, modes: Modes, rings_in: Sequence[Mode]) -> ImpulseResponse:
    """Return G without the modes of the frame, and 1 at rest again.

    modes: that describe it. rings_in: those that it is made of where it has decayed otherwise, of
    which nothing must stay: a description by modes is 1 to 5 % off at their peaks.
    """
    frame = modes.only(rocking_flags(modes))
    own = [bool((np.abs(mode.omega / frame.omega - 1.0) < SAME).any()) for mode in rings_in]
    if sum(own) == len(frame.omega):
        frame = _at_the_end(G, rings_in).only(np.array(own))
    kept = 1.0 - float(frame.c.sum())
    late = frame.delay / TS
    k = np.arange(len(G.deviation), dtype=float) - G.lead
    whole = np.arange(len(k), dtype=float)
    gone = np.interp(k - late, whole, frame.deviation(len(k)), 0.0, 0.0)
    lag = frame.lag + late * frame.c.sum()
    return replace(G, deviation=(G.deviation - gone) / kept, lag=float(G.lag - lag) / kept)


def _at_the_end(G: ImpulseResponse, rings_in: Sequence[Mode]) -> Modes:
    """Return the modes in which G rings after what decays has ended, as seen from its start."""
    omega, zeta = np.transpose([(mode.omega, mode.zeta) for mode in rings_in])
    poles = np.array([mode.pole for mode in rings_in])
    k = np.arange(AFTER, len(G.deviation) - G.lead)
    turning = np.exp(np.outer(k, poles))
    columns = np.hstack([turning.real, -turning.imag])
    parts = np.linalg.lstsq(columns, G.deviation[k + G.lead], rcond=1e-12)[0].reshape(2, -1)
    # q = Re(A e^{pk}) is that of (c + d p/ω) ω²/(i ω' p²) e^{pk}, see ``Modes.deviation``
    shares = (parts[0] + 1j * parts[1]) * 1j * poles.imag * poles**2 / omega**2
    d = shares.imag * omega / poles.imag
    return Modes(omega, zeta, shares.real - d * poles.real / omega, d, 1.0, 0.0)


def left_below(
    runs: Sequence[FrequencyResponse], model: Modes, resonance_hz: float
) -> Rocking | None:
    """Return a mode below half the lowest resonance that all runs show and the model leaves."""
    found = [_light_mode(run, model, resonance_hz / 2.0) for run in runs]
    seen = [one for one in found if one is not None]
    hz = [one.hz for one in seen]
    if not seen or len(seen) < len(runs) or max(hz) > 1.05 * min(hz):
        return None
    return seen[-1]


def _light_mode(run: FrequencyResponse, model: Modes, highest_hz: float) -> Rocking | None:
    part = run.within((run.hz[0], highest_hz))
    if len(part.hz) < 20:
        return None
    left = part.H / model.response(part.hz) - 1.0
    weight = 1.0 / (0.05 + part.noise) ** 2
    left = left - np.median(left.real)
    best, at, size = 0.0, (0.0, 1.0), 0.0
    for hz in np.geomspace(1.1 * part.hz[0], highest_hz / 1.1, 120):
        for damping in (0.01, 0.02, 0.04, 0.08, 0.15):
            mode = _mode(part.hz, hz, damping)
            along = float((weight * mode.conj() * left).sum().real)
            share = along / float((weight * np.abs(mode) ** 2).sum())
            if share * along > best:
                best, at, size = share * along, (float(hz), damping), share
    explained = best / float((weight * np.abs(left) ** 2).sum())
    peak = size / (2.0 * at[1])
    return Rocking(*at, peak) if explained > 0.5 and peak > VISIBLE else None


def _mode(hz: Array, at: float, damping: float) -> Complex:
    r = hz / at
    return np.asarray(r**2 / (1.0 - r**2 + 2j * damping * r))
