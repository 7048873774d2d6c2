"""The frame that rocks on its table: measured, but not compensated.

The reaction of a moving head shakes the whole machine on its feet. A sensor on the nozzle feels it
as a light mode far below the others; but nozzle and bed move together, so it does not show in a
print. A command that cancelled it would.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Complex, Flags
from hframe_post.identification.fitting.modal import Modal
from hframe_post.identification.responses.frequency_response import FrequencyResponse

BELOW = 1.0 / 3.0  # of the strongest mode's frequency
LIGHT = 0.2  # of the motion at rest, and a greater damping ratio than frames on feet have
SHARED = 0.4  # of the answer, that the bed has at least if the whole printer rocks
VISIBLE = 0.15  # of the answer, from which a peak is reported


@dataclass(frozen=True, slots=True)
class Rocking:
    """A light mode far below the others.

    share: of the answer at its peak. shared: whether a second sensor, on the bed, moves as well;
    None without one.
    """

    hz: float
    damping: float
    share: float
    shared: bool | None = None

    def message(self, axis: str) -> str:
        seen = (
            f"{axis}: something answers at {self.hz:.1f} Hz with {100 * self.share:.0f} % of the "
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
        """Return the same with what a second sensor tells by its answer (k,) at hz (k,)."""
        near = np.abs(hz / self.hz - 1.0) < 0.1
        return replace(self, shared=bool(second[near].max(initial=0.0) > SHARED * self.share))


def without_rocking(model: Modal) -> Modal:
    """Return the motion of the nozzle relative to the bed."""
    flags = _rocking(model)
    return model.without(flags) if flags.any() else model


def largest_rocking(model: Modal) -> Rocking | None:
    flags = _rocking(model)
    if not flags.any():
        return None
    zeta = model.parameters.zeta
    share = np.where(flags, np.hypot(model.c, model.d) / (2.0 * zeta * abs(model.gain)), 0.0)
    k = int(np.argmax(share))
    hz = float(model.parameters.omega[k] / (2.0 * np.pi))
    return Rocking(hz, float(zeta[k]), float(share[k]))


def _rocking(model: Modal) -> Flags:
    """Flag the modes (modes,) that are the frame's; racking, 0 at rest, has none."""
    omega, zeta = model.parameters.omega, model.parameters.zeta
    size = np.hypot(model.c, model.d)
    strongest = omega[np.argmax(size)] if len(omega) else 0.0
    light = (size < LIGHT * abs(model.gain)) & (zeta < LIGHT)
    return np.asarray(light & (omega < BELOW * strongest))


def left_below(
    runs: Sequence[FrequencyResponse], model: Modal, resonance_hz: float
) -> Rocking | None:
    """Return a mode below half the lowest resonance that all runs show and the model leaves."""
    found = [_light_mode(run, model, resonance_hz / 2.0) for run in runs]
    seen = [one for one in found if one is not None]
    hz = [one.hz for one in seen]
    if not seen or len(seen) < len(runs) or max(hz) > 1.05 * min(hz):
        return None
    return seen[-1]


def _light_mode(run: FrequencyResponse, model: Modal, highest_hz: float) -> Rocking | None:
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
