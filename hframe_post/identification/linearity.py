"""Is it one linear machine? Harmonics of the sweep in what the sensor heard, and their cause.

A linear printer answers a sine by a sine. The sweep's phase φ(t) is known, so the answer is taken
apart into A_k(t) e^{jkφ} in short windows. What lies at half-way orders, k + ½, is noise.

===========  =============================================  ========================================
cause        force or motion                                its harmonic
===========  =============================================  ========================================
friction     −F·sign(v) on the carriage                     A_3 = 4F/3π·(1 − G(3f))·e^{3j(α − π/2)}
backlash     −b/2·sign(v of the motor) of the motor's way   A_3 = −2b/3π·(3ω)²·G(3f)·e^{−3jπ/2}
hardening    a belt that gets stiffer when it is pulled     A_3 ∝ |A_1|³·(1 − G(3f))·e^{3jα}
one-sided    one that is stiffer one way than the other     A_2 ∝ |A_1|²·(1 − G(2f))·e^{2jα}
===========  =============================================  ========================================

α is the phase of A_1. Friction and backlash go along alike with frequency, and differ in phase:
the carriage turns around later than the motor.

Motors step, and a sine in whole steps has harmonics, too: 1 to 2.6 % of the answer where a step is
20 µm, more than 10 µm of backlash make. But their phases are those of the place on the motor's
grid, and the sway takes the sweep across many steps: from window to window they go along with no
cause. So a harmonic counts as far as it goes along with one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, hilbert, sosfiltfilt

from hframe_post.arrays import TS, Array, Complex, Flags
from hframe_post.identification.clock_sync import QUIETEST, marks_of
from hframe_post.model.transfer_function import TransferFunction

WINDOW, HOP = 1000, 500  # samples
LOWEST_HZ = 5.0  # of the sweep, from which orders are apart
SWAY_HZ = 1.5  # below it lies the sway, which is no part of the sweep
HIGHEST_HZ = 240.0  # to which recordings are flat
CLEAR = 3.0  # times the noise, from which a harmonic is one
TOLD = 0.004  # of the answer, from which harmonics that go along with a cause are worth a word:
LIKE = 0.5  # correlation with it, at least. Of whole steps it is 0.05 to 0.25, of a cause 0.7 to 1
STEPPED = 2.0  # of the answer by mm of a step: harmonics beyond these no steps explain
CAUSES = {
    "friction": "Coulomb friction of at least {size:.0f} mm/s²: clean and grease the rails, and "
    "see that no belt is too tight",
    "backlash": "backlash: look for a loose belt, pulley or carriage",
    "hardening": "a belt or mount that gets stiffer the harder it is pulled: look for what "
    "is loose",
    "one-sided": "a belt or mount that is stiffer one way than the other: set the belts' tension",
}
BIN_HZ = 1.0  # over which what is not linear is averaged
ORDER = {"friction": 3, "backlash": 3, "hardening": 3, "one-sided": 2}  # of the harmonic


@dataclass(frozen=True, slots=True)
class Harmonics:
    """Of one run, a row a window: hz (w,), amplitude by order and power of noise (w, 3)."""

    hz: Array
    amplitude: Complex
    noise: Array

    def share(self, order: int) -> float:
        """Of the answer's amplitude that a harmonic is; 0 where noise may be all of it."""
        used = _used(self.hz, order)
        if not used.any():
            return 0.0
        power, first = (np.abs(self.amplitude[used][:, [order - 1, 0]]) ** 2).mean(axis=0)
        quiet = float(np.median(self.noise[used, order - 1]) / np.log(2.0))
        heard = float(power) - quiet
        return float(np.sqrt(heard / first)) if heard > CLEAR * quiet / np.sqrt(used.sum()) else 0.0


@dataclass(frozen=True, slots=True)
class Distortion:
    """Of a measured response, by what is not linear: share (k,) of it at hz (k,), ascending."""

    hz: Array
    share: Array

    def at(self, hz: Array) -> Array:
        """Its share at other frequencies."""
        return np.interp(hz, self.hz, self.share)


@dataclass(frozen=True, slots=True)
class Nonlinearity:
    """What was found. shares: axis → of its answer's amplitude that harmonics are; size: mm/s² of
    friction, where that is the cause. distortions: of what is measured, by transfer function."""

    cause: str
    shares: dict[str, float]
    size: float
    distortions: dict[str, Distortion]

    @property
    def share(self) -> float:
        """Of the worse axis."""
        return max(self.shares.values())

    def told(self) -> str:
        """For the user."""
        cause = CAUSES[self.cause].format(size=self.size)
        where = " and ".join(f"{100 * s:.1f} % in {axis}" for axis, s in self.shares.items())
        return f"the printer is not linear: a sine is answered by harmonics ({where}): {cause}"


def harmonics(command: Array, acceleration: Array) -> Harmonics | None:
    """Orders 1 to 3 of the sweep between the marks; None without marks.

    command, acceleration (m,): mm/s² along the swept axis, every 1 ms.
    """
    moving = np.flatnonzero(np.abs(command) > QUIETEST * np.abs(command).max(initial=0.0))
    marks = marks_of(command, moving)
    if marks is None:
        return None
    part = slice(marks.first + marks.length + marks.answer, marks.second)
    sos = butter(4, SWAY_HZ, "highpass", fs=1.0 / TS, output="sos")
    phase = np.unwrap(np.angle(hilbert(sosfiltfilt(sos, command[part]))))
    a = sosfiltfilt(sos, acceleration[part])
    starts = np.arange(0, len(phase) - WINDOW, HOP)
    taper = np.hanning(WINDOW)
    taper /= taper.sum()

    def order(k: float) -> Complex:
        turned = a * np.exp(-1j * k * phase)
        views = np.lib.stride_tricks.sliding_window_view(turned, WINDOW)[starts]
        return np.asarray(2.0 * views @ taper)

    hz = (phase[starts + WINDOW] - phase[starts]) / (2.0 * np.pi * WINDOW * TS)
    amplitude = np.column_stack([order(k) for k in (1.0, 2.0, 3.0)])
    beside = np.column_stack([order(k) for k in (1.5, 2.5, 3.5)])
    return Harmonics(hz, amplitude, np.abs(beside) ** 2)


def nonlinearity(
    axes: Mapping[str, tuple[Sequence[Harmonics], TransferFunction, float]], step: float
) -> Nonlinearity | None:
    """What the harmonics tell, of the runs of each axis, its model and the delay (s) in that.

    step: mm of belt, of the motors. None: nothing to tell.
    """
    shares: dict[str, float] = {}
    likeness = dict.fromkeys(CAUSES, 0.0)
    size = 0.0
    for name, (runs, G, lag) in axes.items():
        heard = _together(runs)
        own = {k: heard.share(k) for k in (2, 3)}
        likely = _likeness(heard, G, lag)
        along = {cause: own[ORDER[cause]] * like for cause, like in likely.items()}
        best = max(along, key=lambda cause: along[cause])
        whole = float(np.hypot(own[2], own[3]))
        if not (along[best] > max(TOLD, LIKE * own[ORDER[best]]) or whole > STEPPED * step):
            continue
        shares[name] = whole
        for cause, value in along.items():
            likeness[cause] += value**2
        size = max(size, _friction(heard, G, lag))
    if not shares:
        return None
    cause = max(likeness, key=lambda name: likeness[name])
    bent = {
        name: _distortion(cause, _together(runs), G, lag) for name, (runs, G, lag) in axes.items()
    }
    return Nonlinearity(cause, shares, size, {f"G{name}{name}": one for name, one in bent.items()})


def _distortion(cause: str, heard: Harmonics, G: TransferFunction, lag: float) -> Distortion:
    """What the cause of a harmonic makes of the motion's own frequency."""
    order = ORDER[cause]
    used = _used(heard.hz, order)
    shape, values = SHAPES[cause](heard, used, G, lag, order), heard.amplitude[used, order - 1]
    size = abs(np.vdot(shape, values)) / np.vdot(shape, shape).real
    inside = heard.hz > LOWEST_HZ
    own = size * np.abs(SHAPES[cause](heard, inside, G, lag, 1)) * OWN[cause]
    share = own / np.abs(heard.amplitude[inside, 0])
    edges = np.arange(LOWEST_HZ, heard.hz.max(), BIN_HZ)
    bins = np.digitize(heard.hz[inside], edges)
    held = [k for k in range(1, len(edges) + 1) if (bins == k).any()]
    return Distortion(
        np.array([heard.hz[inside][bins == k].mean() for k in held]),
        np.array([share[bins == k].mean() for k in held]),
    )


def _together(runs: Sequence[Harmonics]) -> Harmonics:
    """The windows of all runs."""
    hz, amplitude, noise = (
        np.concatenate([getattr(run, part) for run in runs])
        for part in ("hz", "amplitude", "noise")
    )
    return Harmonics(hz, amplitude, noise)


def _used(hz: Array, order: int) -> Flags:
    return np.asarray((hz > LOWEST_HZ) & (order * hz < HIGHEST_HZ))


def _likeness(heard: Harmonics, G: TransferFunction, lag: float) -> dict[str, float]:
    """How well harmonics go along with each cause, 0 … 1: correlation, without the noise."""
    told = {}
    for name, shape in SHAPES.items():
        order = ORDER[name]
        used = _used(heard.hz, order)
        values, own = heard.amplitude[used, order - 1], shape(heard, used, G, lag, order)
        size = heard.share(order) * np.linalg.norm(heard.amplitude[used, 0])
        length = float(np.linalg.norm(own)) * float(size)
        told[name] = min(float(abs(np.vdot(own, values))) / length, 1.0) if length else 0.0
    return told


def _friction(heard: Harmonics, G: TransferFunction, lag: float) -> float:
    """mm/s² of friction that the third harmonic would be of."""
    used = _used(heard.hz, 3)
    shape = _of_friction(heard, used, G, lag, 3)
    return float(abs(np.vdot(shape, heard.amplitude[used, 2])) / np.vdot(shape, shape).real)


def _of_friction(
    heard: Harmonics, used: Flags, G: TransferFunction, lag: float, order: int
) -> Complex:
    """The harmonic of a unit of friction: on the carriage, behind no delay."""
    unit = 4.0 / (order * np.pi) * (-1j) ** (order + 2)
    return np.asarray(unit * _on_carriage(heard, used, G, lag, order))


def _of_backlash(
    heard: Harmonics, used: Flags, G: TransferFunction, lag: float, order: int
) -> Complex:
    hz = heard.hz[used]
    return np.asarray(order * hz**2 * G.response(2.0 * np.pi * order * hz * TS))


def _of_hardening(
    heard: Harmonics, used: Flags, G: TransferFunction, lag: float, order: int
) -> Complex:
    size = np.abs(heard.amplitude[used, 0])
    return np.asarray(size**3 * _on_carriage(heard, used, G, lag, order))


def _of_one_side(
    heard: Harmonics, used: Flags, G: TransferFunction, lag: float, order: int
) -> Complex:
    size = np.abs(heard.amplitude[used, 0])
    return np.asarray(size**2 * _on_carriage(heard, used, G, lag, order))


def _on_carriage(
    heard: Harmonics, used: Flags, G: TransferFunction, lag: float, order: int
) -> Complex:
    """The harmonic of a unit of force on the carriage, in phase with the answer's own."""
    omega = 2.0 * np.pi * order * heard.hz[used]
    prompt = G.response(omega * TS) * np.exp(1j * omega * lag)
    first = heard.amplitude[used, 0]
    return np.asarray((1.0 - prompt) * (first / np.abs(first)) ** order)


SHAPES = {
    "friction": _of_friction,
    "backlash": _of_backlash,
    "hardening": _of_hardening,
    "one-sided": _of_one_side,
}
OWN = {"friction": 1.0, "backlash": 1.0, "hardening": 3.0, "one-sided": 1.0}
