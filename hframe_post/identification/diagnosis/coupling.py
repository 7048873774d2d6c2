"""What a command in one axis does to the other, as far as several recordings show it alike.

On a published CoreXY what x does to y came back the next day, on another one it did not. What does
not repeat is reported, and not compensated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hframe_post.arrays import TS, Array, Complex, X, Y
from hframe_post.identification.fitting.modal import Modal
from hframe_post.identification.fitting.shared import CrossTerm, shared
from hframe_post.identification.responses.crossed import Crossed
from hframe_post.identification.responses.frequency_response import FrequencyResponse, average
from hframe_post.model.plant import Coupling

REPEATS = 0.7  # share of a recording's coupling that the others may fail to foresee
LEAST_SHARE = 0.02  # of the axis' own error in a print, from which a coupling is compensated
SMOOTHED_HZ = 1.0  # over which neighbouring frequencies are averaged; modes are wider
ABOVE_NOISE = 3.0
LEAST_SIZE = 0.06  # of the command, below which a single recording shows no coupling
TURNED = np.radians(2.0)  # by which a sensor is turned before the report says so
LEAST_MODE = 0.03  # of a mode across, to be listed
PITCHES = 0.3  # of the answer along, from which that in z is reported


@dataclass(frozen=True, slots=True)
class CoupledMode:
    """A mode, and how much of it each axis shows at its resonance, per command of one axis."""

    hz: float
    damping: float
    along: float
    across: float


@dataclass(frozen=True, slots=True)
class MeasuredCoupling:
    """What a command in ``axis`` does to ``other``, x or y.

    runs: without what a turned sensor sees. terms: what they share, to be compensated. model: all
    of it at the mean place, with gain and delay of ``along``, the model of the axis itself. turn:
    rad by which the sensor is turned, at the most. hz, size, wrong: where the coupling is greatest,
    how great, and |G − 1| of the axis itself there; size 0 if it is nowhere above its noise.
    unexplained: share of the coupling of a recording that the others do not foresee; None if there
    are too few.
    """

    axis: str
    other: str
    runs: tuple[Crossed, ...]
    terms: tuple[CrossTerm, ...]
    model: Modal
    along: Modal
    turn: float
    hz: float
    size: float
    wrong: float
    unexplained: float | None

    @property
    def counts(self) -> bool:
        """Return whether several recordings show it alike."""
        known = self.unexplained is not None and self.unexplained <= REPEATS
        return known and self.size > 0.0

    def cross(self, delay: float) -> tuple[Coupling, ...]:
        """Return what is compensated, for a printer with this delay, s."""
        answer, command = "xy".index(self.other), "xy".index(self.axis)
        functions = [term.model.discrete(delay, self.along.gain) for term in self.terms]
        return tuple(
            Coupling(answer, command, G, term.along, term.centre)
            for G, term in zip(functions, self.terms, strict=True)
        )

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
            if across > LEAST_MODE:
                hz = float(omega) / (2.0 * np.pi)
                found.append(CoupledMode(hz, float(zeta), share, float(across)))
        return sorted(found, key=lambda mode: mode.hz)

    def as_text(self) -> str:
        """Return one sentence for the report."""
        if self.size == 0.0 or (not self.counts and self.size < LEAST_SIZE):
            return f"a command in {self.axis} does not move {self.other}"
        text = (
            f"a command in {self.axis} moves {self.other} by {self.size:.2f} at {self.hz:.0f} Hz, "
            f"{100 * self.size / self.wrong:.0f} % of {self.axis}'s own error there"
        )
        if self.unexplained is None:
            tests = f"two tests of {self.axis} alone show whether it repeats"
            return f"{text}; it is not compensated: {tests}"
        if not self.counts:
            differ = f"{100 * self.unexplained:.0f} % differ"
            return f"{text}; it does not repeat ({differ}) and is not compensated"
        repeats = f"it repeats within {max(100 * self.unexplained, 1.0):.0f} %"
        if not self.terms:
            return f"{text}; {repeats}, but is too small to be compensated"
        axes = [axis for axis in (X, Y) if any(term.along == axis for term in self.terms)]
        along = "".join(f" and changes along {'xy'[axis]}" for axis in axes)
        return f"{text}; {repeats}{along}, and is compensated"

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
    axis: str, runs: Sequence[Crossed], models: Sequence[Modal], known: int = 0
) -> MeasuredCoupling:
    """Return what a command in ``axis`` (x or y) does to the other axis.

    runs: on one delay and the same frequencies. models: of the axis itself, fitted on that delay,
    then others whose modes may take part. known: lever arms that were found from the same runs, and
    have been removed from them.
    """
    found = shared(runs, models, known)
    along = average([run.along for run in runs])
    coupled = [
        replace(run, across=replace(run.across, H=fit.coupling(run)))
        for run, fit in zip(runs, found.fits, strict=True)
    ]
    # the mean of what changes, with the place or by itself, may be 0
    alike = found.left <= REPEATS and len(found.axes) == 1
    across = [run.across for run in coupled]
    shown = [average(across)] if alike else across
    sizes = [_greatest(along, one, models[0]) for one in shown]
    hz, size, wrong = max(sizes, key=lambda one: one[1])
    repeats = found.left <= REPEATS and size > 0.0
    terms = [term for term in found.terms() if repeats and found.size(term) > LEAST_SHARE]
    return MeasuredCoupling(
        axis, "y" if axis == "x" else "x", tuple(coupled), tuple(terms), found.at_mean, models[0],
        max((fit.turn for fit in found.fits), key=abs), hz, size, wrong,
        found.left if found.free > 0 else None,
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


def _smoothed(values: Array | Complex, n: int) -> Complex:
    padded = np.pad(np.asarray(values, dtype=complex), (n // 2, n - 1 - n // 2), mode="edge")
    return np.asarray(np.convolve(padded, np.ones(n) / n, "valid"))


@dataclass(frozen=True, slots=True)
class Pitch:
    """What z shows while ``axis`` moves: where most, and how much, relative to the axis itself."""

    axis: str
    hz: float
    share: float


def pitching(
    axis: str, along: FrequencyResponse, z: FrequencyResponse, height: float | None
) -> Pitch | None:
    """Return how the head pitches while ``axis`` moves; None if it does not.

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
    return Pitch(axis, float(z.hz[most]), float(share[most]))


def pitch_note(found: Sequence[Pitch]) -> str:
    """Return what pitching costs, in one note for all axes."""
    shown = " and ".join(f"{one.share:.1f} times {one.axis} at {one.hz:.0f} Hz" for one in found)
    return (
        f"the head pitches: the sensor's z answers {shown}. Around there a sensor above the nozzle "
        "feels another motion than the nozzle makes, so compensation may bring less than predicted "
        "('--sensor-offset 0,0,0' if it sits at the nozzle's height)"
    )
