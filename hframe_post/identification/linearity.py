"""Is it one linear machine? Harmonics of the sweep in what the sensor heard, and their cause.

A linear printer answers a sine by a sine. The sweep's phase φ(t) is known, so the answer is taken
apart into A_k(t) e^{jkφ} in short windows. What lies at half-way orders, k + ½, is noise.

===========  =============================================  ========================================
cause        force or motion                                its harmonic A_3
===========  =============================================  ========================================
friction     −F·sign(v) on the carriage                     4F/3π·(1 − G(3f))·e^{3j(α − π/2)}
backlash     −b/2·sign(v of the motor) of the motor's way   −2b/3π·(3ω)²·G(3f)·e^{−3jπ/2}
hardening    a belt that gets stiffer when it is pulled     ∝ |A_1|³·(1 − G(3f))·e^{3jα}
one-sided    one that is stiffer one way than the other     A_2, which the others hardly have
===========  =============================================  ========================================

α is the phase of A_1. Friction and backlash go along alike with frequency, and differ in phase:
the carriage turns around later than the motor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, hilbert, sosfiltfilt

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.clock_sync import QUIETEST, marks_of
from hframe_post.model.transfer_function import TransferFunction

WINDOW, HOP = 1000, 500  # samples
LOWEST_HZ = 5.0  # of the sweep, from which orders are apart
SWAY_HZ = 1.5  # below it lies the sway, which is no part of the sweep
HIGHEST_HZ = 240.0  # to which recordings are flat
CLEAR = 3.0  # times the noise, from which a harmonic is one
TOLD = 0.01  # of the answer, from which harmonics are worth a word
CLEAN = 0.04  # up to which any model may be fitted: whole motor steps alone make 0.026
CAUSES = {
    "friction": "Coulomb friction of at least {size:.0f} mm/s²: clean and grease the rails, and "
    "see that no belt is too tight",
    "backlash": "backlash: look for a loose belt, pulley or carriage",
    "hardening": "a belt or mount that gets stiffer the harder it is pulled: look for what "
    "is loose",
    "one-sided": "a belt or mount that is stiffer one way than the other: set the belts' tension",
}


@dataclass(frozen=True, slots=True)
class Harmonics:
    """Of one run, a row a window: hz (w,), amplitude by order and power of noise (w, 3)."""

    hz: Array
    amplitude: Complex
    noise: Array


@dataclass(frozen=True, slots=True)
class Nonlinearity:
    """What was found. shares: axis → of its answer's amplitude that harmonics are; size: mm/s² of
    friction, where that is the cause."""

    cause: str
    shares: dict[str, float]
    size: float

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
    axes: Mapping[str, tuple[Sequence[Harmonics], TransferFunction, float]],
) -> Nonlinearity | None:
    """What the harmonics tell, of the runs of each axis, its model and the delay (s) in that.

    None: nothing to tell.
    """
    shares: dict[str, float] = {}
    likeness = dict.fromkeys(("friction", "backlash", "hardening"), 0.0)
    even, size = 0.0, 0.0
    for name, (runs, G, lag) in axes.items():
        hz, amplitude, noise = (
            np.concatenate([getattr(run, part) for run in runs])
            for part in ("hz", "amplitude", "noise")
        )
        second, third = (_share(hz, amplitude, noise, k) for k in (2, 3))
        if np.hypot(second, third) < TOLD:
            continue
        shares[name] = float(np.hypot(second, third))
        even += second**2 - third**2
        used = _used(hz, 3)
        for cause, value in _odd(hz[used], amplitude[used], G, lag).items():
            likeness[cause] += third * value
        size = max(size, _friction(hz[used], amplitude[used], G, lag))
    if not shares:
        return None
    cause = "one-sided" if even > 0.0 else max(likeness, key=lambda name: likeness[name])
    return Nonlinearity(cause, shares, size)


def clean(runs: Sequence[Harmonics]) -> bool:
    """Whether the runs, at least one, show no harmonics worth a word."""
    if not runs:
        return False
    hz, amplitude, noise = (
        np.concatenate([getattr(run, part) for run in runs])
        for part in ("hz", "amplitude", "noise")
    )
    second, third = (_share(hz, amplitude, noise, order) for order in (2, 3))
    return bool(np.hypot(second, third) < CLEAN)


def _share(hz: Array, amplitude: Complex, noise: Array, order: int) -> float:
    """Of the answer's amplitude that a harmonic is; 0 where noise may be all of it."""
    used = _used(hz, order)
    if not used.any():
        return 0.0
    power, first = (np.abs(amplitude[used][:, [order - 1, 0]]) ** 2).mean(axis=0)
    quiet = float(np.median(noise[used, order - 1]) / np.log(2.0))
    heard = float(power) - quiet
    return float(np.sqrt(heard / first)) if heard > CLEAR * quiet / np.sqrt(used.sum()) else 0.0


def _used(hz: Array, order: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray((hz > LOWEST_HZ) & (order * hz < HIGHEST_HZ))


def _odd(hz: Array, amplitude: Complex, G: TransferFunction, lag: float) -> dict[str, float]:
    """How well the third harmonic goes along with each cause, 0 … 1."""
    first, heard = amplitude[:, 0], amplitude[:, 2]
    shapes = {
        "friction": _of_friction(hz, first, G, lag),
        "backlash": hz**2 * G.response(6.0 * np.pi * hz * TS),
        "hardening": -1j * np.abs(first) ** 3 * _of_friction(hz, first, G, lag),
    }
    return {
        name: float(abs(np.vdot(shape, heard)) / (np.linalg.norm(shape) * np.linalg.norm(heard)))
        for name, shape in shapes.items()
    }


def _friction(hz: Array, amplitude: Complex, G: TransferFunction, lag: float) -> float:
    """mm/s² of friction that the third harmonic would be of."""
    shape = _of_friction(hz, amplitude[:, 0], G, lag)
    return float(abs(np.vdot(shape, amplitude[:, 2])) / np.vdot(shape, shape).real)


def _of_friction(hz: Array, first: Complex, G: TransferFunction, lag: float) -> Complex:
    """The third harmonic of a unit of friction: on the carriage, behind no delay."""
    omega = 6.0 * np.pi * hz
    prompt = G.response(omega * TS) * np.exp(1j * omega * lag)
    turn = (first / np.abs(first)) ** 3
    return np.asarray(4.0 / (3.0 * np.pi) * 1j * (1.0 - prompt) * turn)
