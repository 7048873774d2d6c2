"""How much a command in one axis moves the other, and whether that repeats.

A coupling counts only if a second recording shows it, too: on a published CoreXY what x does to y
came back the next day, on another one it did not. Racking couples as well, by another amount at
each place; here it is that at the mean place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.fitting.cross import fit_cross, with_own_modes
from hframe_post.identification.fitting.modal import Modal
from hframe_post.identification.responses.frequency_response import FrequencyResponse, average

REPEATS = 0.7  # share of the second recording's coupling that the first may leave unexplained
SMOOTHED_HZ = 1.0  # over which neighbouring frequencies are averaged; modes are wider
ABOVE_NOISE = 3.0
LEAST_SIZE = 0.06  # of the command, below which a single recording shows no coupling
TURNED = np.radians(2.0)  # by which a sensor is turned before the report says so
LEAST_SHARE = 0.03  # of a mode across, to be listed
PITCHES = 0.3  # of the answer along, from which that in z is reported


@dataclass(frozen=True, slots=True)
class CoupledMode:
    """A mode, and how much of it each axis shows at its resonance, per command of one axis."""

    hz: float
    damping: float
    along: float
    across: float


@dataclass(frozen=True, slots=True)
class Coupling:
    """What a command in ``axis`` does to ``other``, x or y.

    model: the coupling, with gain and delay of ``along``, the model of the axis itself. turn: rad
    by which the sensor is turned, at the most. hz, size, wrong: where the coupling is greatest, how
    great, and |G − 1| of the axis itself there; size 0 if it is nowhere above its noise.
    unexplained: share of the coupling of another recording that the first leaves; None with a
    single recording.
    """

    axis: str
    other: str
    model: Modal
    along: Modal
    turn: float
    hz: float
    size: float
    wrong: float
    unexplained: float | None

    @property
    def counts(self) -> bool:
        """Return whether two recordings show it alike."""
        known = self.unexplained is not None and self.unexplained <= REPEATS
        return known and self.size > 0.0

    @property
    def modes(self) -> list[CoupledMode]:
        """Return the modes with a share across, lowest frequency first."""
        model, gain = self.model, self.along.gain
        sizes = np.hypot(model.c, model.d) / gain
        known = self.along.parameters.omega
        itself = np.hypot(self.along.c, self.along.d) / gain
        found = []
        for omega, zeta, across in zip(
            model.parameters.omega, model.parameters.zeta, sizes, strict=True
        ):
            share = float(itself[known == omega].sum())
            if across > LEAST_SHARE:
                hz = float(omega) / (2.0 * np.pi)
                found.append(CoupledMode(hz, float(zeta), share, float(across)))
        return sorted(found, key=lambda mode: mode.hz)

    def as_text(self) -> str:
        """Return one sentence for the report."""
        if self.size == 0.0 or (self.unexplained is None and self.size < LEAST_SIZE):
            return f"a command in {self.axis} does not move {self.other}"
        text = (
            f"a command in {self.axis} moves {self.other} by {self.size:.2f} at {self.hz:.0f} Hz, "
            f"{100 * self.size / self.wrong:.0f} % of {self.axis}'s own error there"
        )
        if self.unexplained is None:
            return f"{text}; record {self.axis} again to see whether that repeats"
        if self.counts:
            return f"{text}; it repeats within {max(100 * self.unexplained, 1.0):.0f} %"
        return f"{text}; it does not repeat ({100 * self.unexplained:.0f} % differ) and is ignored"

    def warnings(self) -> list[str]:
        if abs(self.turn) < TURNED:
            return []
        return [
            f"the sensor is turned by {np.degrees(abs(self.turn)):.0f}° about the vertical: it "
            f"shows in {self.other} a constant share of {self.axis}, which is removed"
        ]

    def as_json(self) -> dict[str, Any]:
        return {
            "axis": self.axis, "other": self.other, "repeats": self.counts,
            "unexplained": self.unexplained, "hz": self.hz, "size": self.size,
            "axis_itself_off": self.wrong, "sensor_turned_deg": float(np.degrees(self.turn)),
            "modes": [
                {"hz": mode.hz, "damping": mode.damping, self.axis: mode.along,
                 self.other: mode.across}
                for mode in self.modes
            ],
        }  # fmt: skip


def find_coupling(
    axis: str,
    sessions: Sequence[tuple[FrequencyResponse, FrequencyResponse]],
    models: tuple[Modal, Modal | None],
) -> Coupling:
    """Return what a command in ``axis`` (x or y) does to the other axis.

    sessions: the responses along and across of each recording, on one delay and the same
    frequencies. models: of the axis itself, fitted on that delay, and of the other, if known.
    """
    known = [model for model in models if model is not None]
    if len(sessions) > 1:
        first, second = ((across, along) for along, across in sessions[:2])
        known = with_own_modes(first, second, known)
    fits = [fit_cross(across, along, known) for along, across in sessions]
    coupled = [
        replace(across, H=fit.coupling(across, along))
        for fit, (along, across) in zip(fits, sessions, strict=True)
    ]
    along, across = average([along for along, _ in sessions]), average(coupled)
    hz, size, wrong = _greatest(along, across, models[0])
    others = [_unexplained(coupled[0], later, along.power) for later in coupled[1:]]
    return Coupling(
        axis, "y" if axis == "x" else "x", fit_cross(across, along, known).model, models[0],
        max((fit.turn for fit in fits), key=abs), hz, size, wrong, max(others, default=None),
    )  # fmt: skip


def _greatest(
    along: FrequencyResponse, across: FrequencyResponse, model: Modal
) -> tuple[float, float, float]:
    """Return where the coupling is greatest, its size, and |G − 1| of the axis itself there."""
    hz = along.hz
    n = max(int(SMOOTHED_HZ / (hz[1] - hz[0])), 1)
    at_motors = np.exp(2j * np.pi * hz * model.delay) / np.sinc(hz * TS) ** 2 / model.gain
    size = np.abs(_smoothed(across.H * at_motors, n))
    variance = (across.noise * np.abs(across.H) / model.gain) ** 2
    sd = np.sqrt(_smoothed(variance, n).real / n)
    size = np.where(size > ABOVE_NOISE * sd, size, 0.0)
    most = int(np.argmax(size))
    wrong = float(np.abs(_smoothed(along.H * at_motors, n)[most] - 1.0))
    return float(hz[most]), float(size[most]), wrong


def _unexplained(first: FrequencyResponse, second: FrequencyResponse, power: Array) -> float:
    """Return the share of the second that the first leaves, both without their noise."""
    noises = [(each.noise * np.abs(each.H)) ** 2 for each in (first, second)]
    left = (power * (np.abs(second.H - first.H) ** 2 - sum(noises))).sum()
    whole = (power * (np.abs(second.H) ** 2 - noises[1])).sum()
    return float(np.sqrt(max(left, 0.0) / whole)) if whole > 0.0 else 1.0


def _smoothed(values: Array | Complex, n: int) -> Complex:
    padded = np.pad(np.asarray(values, dtype=complex), (n // 2, n - 1 - n // 2), mode="edge")
    return np.asarray(np.convolve(padded, np.ones(n) / n, "valid"))


def pitching(
    axis: str, along: FrequencyResponse, z: FrequencyResponse, height: float | None
) -> str | None:
    """Return a warning if the head pitches while ``axis`` moves; None if it does not.

    z: the response of the sensor's z to the same command. height: mm of the sensor above the
    nozzle, the z of --sensor-offset; None if it is unknown. A head that pitches by φ moves a sensor
    at that height by height·φ more than the nozzle; z shows that it pitches, but not about which
    point, so one height does not tell φ.
    """
    n = max(int(SMOOTHED_HZ / (z.hz[1] - z.hz[0])), 1)
    size = np.abs(_smoothed(z.H, n))
    sd = np.sqrt(_smoothed((z.noise * np.abs(z.H)) ** 2, n).real / n)
    share = size / np.maximum(np.abs(_smoothed(along.H, n)), 1e-12)
    strong = (size > ABOVE_NOISE * sd) & (size > 0.5 * size.max())
    if height == 0.0 or not strong.any():
        return None
    most = int(np.argmax(np.where(strong, share, 0.0)))
    if share[most] < PITCHES:
        return None
    where = "above the nozzle" if height is None else f"{height:g} mm above the nozzle"
    return (
        f"the head pitches: at {z.hz[most]:.0f} Hz z answers {share[most]:.1f} times as strongly "
        f"as {axis} does. A sensor {where} feels more or less of that than the nozzle, and one "
        "height does not tell how much. Record again with the sensor at another height"
    )
