"""Input shapers: the path convolved with a few impulses that leave no ringing of one mode.

These are what firmware offers; they are here for comparison. With
damped frequency f_d = f·√(1 − ζ²), period t_d = 1/f_d and K = exp(−π·ζ/√(1 − ζ²)), the decay
of an oscillation in half a period, a shaper is a set of amplitudes A_i at times T_i:

=============  =============================================================================
``zv``         cancels one mode: two impulses half a period apart (Singer and Seering 1990)
``zvd`` …      the same once, twice, three times more, flat in frequency: ``zvdd``, ``zvddd``
``mzv``        three impulses in three quarters of a period
``ei``         a little ringing allowed at f, to tolerate errors of f (Singhose 1994)
``2hump_ei``   ``ei`` with two, and
``3hump_ei``   with three humps of that ringing: more tolerant, longer (Singhose et al. 1997)
``smooth_zv``  the mean over a period instead of impulses: smooth, and cancels one mode;
``smooth_zvd`` that twice. The smoothers of Klipper's forks are polynomials of that kind
=============  =============================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.errors import HframeError

TOLERATED = 0.05  # V of the ei family: remaining share of the ringing without a shaper


@dataclass(frozen=True)
class Shaper:
    """Amplitudes A (k,) with sum 1 at times T (k,), s, ascending, about their mean: no delay."""

    A: Array
    T: Array

    @property
    def reach(self) -> int:
        """Return the number of path samples on either side on which a command sample depends."""
        return int(np.ceil(np.abs(self.T).max() / TS)) + 1

    def taps(self) -> Array:
        """Return the impulses on samples −reach … reach, (2·reach + 1,), interpolated."""
        taps = np.zeros(2 * self.reach + 1)
        place = self.T / TS + self.reach
        before = np.floor(place).astype(int)
        np.add.at(taps, before, self.A * (1.0 - (place - before)))
        np.add.at(taps, before + 1, self.A * (place - before))
        return taps

    def run(self, path: Array) -> Array:
        """Return the command (n,) for a path (n,) that stands still before and after it."""
        padded = np.pad(path, self.reach, mode="edge")
        taps = self.taps()[::-1]
        command, term = np.zeros(len(path)), np.empty(len(path))
        for k in np.flatnonzero(taps).tolist():  # few
            command += np.multiply(taps[k], padded[k : k + len(path)], out=term)
        return command

    def residual(self, hz: Array, damping: float) -> Array:
        """Return the share of ringing that remains of modes at ``hz`` (k,): Singer and Seering."""
        omega = 2.0 * np.pi * hz[:, None]
        phase = omega * np.sqrt(1.0 - damping**2) * self.T
        growth = self.A * np.exp(damping * omega * (self.T - self.T[-1]))
        return np.asarray(
            np.hypot((growth * np.cos(phase)).sum(1), (growth * np.sin(phase)).sum(1))
        )


def shaper(name: str, hz: float, damping: float) -> Shaper:
    """Return the shaper of that name for a mode of a damping ratio. Raises HframeError."""
    if name not in SHAPERS:
        raise HframeError(f"unknown shaper {name!r}: choose one of {', '.join(SHAPERS)}")
    root = np.sqrt(1.0 - damping * damping)
    K = float(np.exp(-np.pi * damping / root))
    amplitudes, periods = SHAPERS[name](K)
    A, T = np.array(amplitudes) / sum(amplitudes), np.array(periods) / (hz * root)
    return Shaper(A, T - A @ T)


@dataclass(frozen=True, slots=True)
class AxisShaping:
    """The shaper of one axis."""

    name: str
    hz: float
    damping: float

    @property
    def shaper(self) -> Shaper:
        return shaper(self.name, self.hz, self.damping)


@dataclass(frozen=True, slots=True)
class Shaping:
    """Shapers of x and y, and their RMS contour error (mm) on the path they were chosen for."""

    x: AxisShaping
    y: AxisShaping
    rms: float = np.inf

    def config(self, dialect: str) -> str:
        """Return the section for Klipper's printer.cfg, or Marlin's commands."""
        axes = (("x", self.x), ("y", self.y))
        if dialect == "marlin":
            lines = ["; for Marlin 2.1.2 or newer with INPUT_SHAPING_X and INPUT_SHAPING_Y"]
            lines += [f"M593 {a.upper()} F{s.hz:.1f} D{s.damping:.3f}" for a, s in axes]
            return "\n".join([*lines, "M500 ; saves it"])
        lines = ["[input_shaper]"]
        for axis, chosen in axes:
            lines += [
                f"shaper_type_{axis}: {chosen.name}",
                f"shaper_freq_{axis}: {chosen.hz:.1f}",
                f"damping_ratio_{axis}: {chosen.damping:.3f}",
            ]
        return "\n".join(lines)

    def as_json(self) -> dict[str, Any]:
        return {
            axis: {"type": s.name, "hz": round(s.hz, 2), "damping": round(s.damping, 4)}
            for axis, s in (("x", self.x), ("y", self.y))
        }

    def as_text(self) -> list[str]:
        """Return frequency and damping of x and of y."""
        return [f"{axis.hz:.1f} ({axis.damping:.2f})" for axis in (self.x, self.y)]


Impulses = tuple[list[float], list[float]]  # amplitudes, and times in damped periods


def _zv(more: int) -> Callable[[float], Impulses]:
    """Return the shaper with zero vibration and ``more`` zero derivatives of it."""
    n = more + 1

    def impulses(K: float) -> Impulses:
        return [comb(n, k) * K**k for k in range(n + 1)], [k / 2.0 for k in range(n + 1)]

    return impulses


def _mzv(K: float) -> Impulses:
    K = K**0.75  # the decay in three quarters of a half period
    ends, middle = 1.0 - 1.0 / np.sqrt(2.0), (np.sqrt(2.0) - 1.0) * K
    return [ends, middle, ends * K * K], [0.0, 0.375, 0.75]


def _ei(K: float) -> Impulses:
    V = TOLERATED
    return [(1.0 + V) / 4.0, (1.0 - V) / 2.0 * K, (1.0 + V) / 4.0 * K * K], [0.0, 0.5, 1.0]


def _two_humps(K: float) -> Impulses:
    V2 = TOLERATED**2
    X = np.cbrt(V2 * (np.sqrt(1.0 - V2) + 1.0))
    a1 = (3.0 * X * X + 2.0 * X + 3.0 * V2) / (16.0 * X)
    a2 = 0.5 - a1
    return [a1, a2 * K, a2 * K**2, a1 * K**3], [0.0, 0.5, 1.0, 1.5]


def _three_humps(K: float) -> Impulses:
    V = TOLERATED
    a1 = (1.0 + 3.0 * V + 2.0 * np.sqrt(2.0 * (V + V * V))) / 16.0
    a2 = (1.0 - V) / 4.0
    a3 = 1.0 - 2.0 * (a1 + a2)
    return [a1, a2 * K, a3 * K**2, a2 * K**3, a1 * K**4], [0.0, 0.5, 1.0, 1.5, 2.0]


def _mean(times: int) -> Callable[[float], Impulses]:
    """Return the mean over a period, applied several times, as 64 impulses a period."""

    def impulses(K: float) -> Impulses:
        amplitudes = np.ones(1)
        for _ in range(times):
            amplitudes = np.convolve(amplitudes, np.ones(64))
        return amplitudes.tolist(), (np.arange(len(amplitudes)) / 64.0).tolist()

    return impulses


SHAPERS: dict[str, Callable[[float], Impulses]] = {
    "zv": _zv(0), "mzv": _mzv, "ei": _ei, "2hump_ei": _two_humps, "3hump_ei": _three_humps,
    "zvd": _zv(1), "zvdd": _zv(2), "zvddd": _zv(3),
    "smooth_zv": _mean(1), "smooth_zvd": _mean(2),
}  # fmt: skip
