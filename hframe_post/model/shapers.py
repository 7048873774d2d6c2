"""Input shapers: the path convolved with a few impulses that leave no ringing of one mode.

These are what firmware offers; they are here for comparison. With
damped frequency f_d = f·√(1 − ζ²), period t_d = 1/f_d and K = exp(−π·ζ/√(1 − ζ²)), the decay
of an oscillation in half a period, a shaper is a set of amplitudes A_i at times T_i:

=================  =========================================================================
``zv``             cancels one mode: two impulses half a period apart (Singer and Seering 1990)
``zvd`` …          the same once, twice, three times more, flat in frequency: ``zvdd``, ``zvddd``
``mzv``            three impulses in three quarters of a period
``mzv(n=4,t=1)``   n impulses in t periods
``ei``             a little ringing allowed at f, to tolerate errors of f (Singhose 1994);
``ei(v_tol=0.1)``  that share of it instead of 0.05
``2hump_ei``       ``ei`` with two, and
``3hump_ei``       with three humps of that ringing: more tolerant, longer (Singhose et al. 1997)
``smooth_zv`` …    a polynomial instead of impulses, without damping: in a branch of Kalico only
=================  =========================================================================

Those of Klipper are as Klipper has them since September 2025, when the ``ei`` family became
polynomials in ζ, which hold up to a largest ζ. Kalico and older versions have the closed forms
of the papers, which at ζ = 0.1 differ by up to 0.03 of all amplitudes, and take any ζ. Parameters
in parentheses need Klipper of 27 April 2026 or newer.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from math import comb
from typing import Any

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.errors import HframeError


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
        """Return the command (n,) for a path (n,) that is at rest before and after it."""
        padded = np.pad(path, self.reach, mode="edge")
        taps = self.taps()[::-1]
        command, term = np.zeros(len(path)), np.empty(len(path))
        for k in np.flatnonzero(taps).tolist():  # few
            command += np.multiply(taps[k], padded[k : k + len(path)], out=term)
        return command


def shaper(name: str, hz: float, damping: float) -> Shaper:
    """Return the shaper of that name for a mode of a damping ratio. Raises HframeError."""
    A, periods = _impulses(name, damping)
    T = periods / hz
    return Shaper(A, T - A @ T)


@lru_cache(maxsize=64)  # a search tries many frequencies with each damping ratio
def _impulses(name: str, damping: float) -> tuple[Array, Array]:
    """Return amplitudes with sum 1, and times in periods, of the impulses. Raises HframeError."""
    kind, parameters = _parsed(name)
    if damping > kind.most_damping:
        raise HframeError(f"{name} is for a damping ratio of at most {kind.most_damping:g}")
    amplitudes, periods = kind.impulses(damping, **parameters)
    return np.array(amplitudes) / sum(amplitudes), np.array(periods)


def most_damping(name: str) -> float:
    """Return the largest damping ratio for which a shaper is made. Raises HframeError."""
    return _parsed(name)[0].most_damping


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

    @property
    def reach(self) -> int:
        """Return the number of path samples on either side on which a command sample depends."""
        return max(self.x.shaper.reach, self.y.shaper.reach)

    def run(self, path: Array) -> Array:
        """Return the command (n, 2) for a path (n, 2) that is at rest before and after it."""
        shapers = self.x.shaper, self.y.shaper
        return np.column_stack([one.run(path[:, axis]) for axis, one in enumerate(shapers)])

    def as_json(self) -> dict[str, Any]:
        return {
            axis: {"type": s.name, "hz": round(s.hz, 2), "damping": round(s.damping, 4)}
            for axis, s in (("x", self.x), ("y", self.y))
        }

    def as_text(self) -> list[str]:
        """Return frequency and damping of x and of y."""
        return [f"{axis.hz:.1f} ({axis.damping:.2f})" for axis in (self.x, self.y)]


Impulses = tuple[Any, Any]  # amplitudes, and times in periods 1/f


@dataclass(frozen=True, slots=True)
class Kind:
    """Impulses of a shaper for a damping ratio, and the largest one that Klipper takes.

    impulses: takes the damping ratio, and parameters by name. parameters: numbers that its name may
    give in parentheses, with their types.
    """

    impulses: Callable[..., Impulses]
    most_damping: float = 0.99
    parameters: tuple[tuple[str, type], ...] = ()


def _root_and_decay(damping: float) -> tuple[float, float]:
    """Return √(1 − ζ²) and K."""
    root = float(np.sqrt(1.0 - damping * damping))
    return root, float(np.exp(-np.pi * damping / root))


def _zv(damping: float, more: int) -> Impulses:
    """Return the shaper with zero vibration and ``more`` zero derivatives of it."""
    root, K = _root_and_decay(damping)
    k, n = np.arange(more + 2), more + 1
    return [comb(n, j) * K**j for j in range(n + 1)], 0.5 * k / root


def _mzv(damping: float, n: int = 3, t: float = 0.75) -> Impulses:
    """Return n impulses in t periods: the polynomial in z whose roots are its zeros.

    The roots are on the unit circle, at equal distances around −1, the first where z turns by
    t/(n − 1) of a period.
    """
    if n < 3 or not 0.0 < 2.0 * t < n - 1.0 - 1e-7:
        raise HframeError(f"mzv(n={n},t={t:g}): n must be at least 3, and t below (n − 1)/2")
    angles = 2.0 * np.pi * np.linspace(t / (n - 1.0), 1.0 - t / (n - 1.0), n - 1)
    A = np.poly(np.exp(1j * angles)).real
    if A.min() < -1e-5 * A.max():
        raise HframeError(f"mzv(n={n},t={t:g}): some impulses would be negative")
    root, K = _root_and_decay(damping)
    T = np.linspace(0.0, t, n)
    return A * K ** (2.0 * T), T / root


EI = (  # of the first and the last amplitude, and of the second time: row ζ^i, column v^j
    [[0.24968, 0.24961], [0.80008, 1.23328], [0.49599, 3.17316]],
    [[0.25149, 0.21474], [-0.83249, 1.41498], [0.85181, -4.90094]],
    [[0.4999, 0.0, 0.0], [0.0, 0.46159, 8.57843], [0.0, 4.26169, -108.644],
     [0.0, 1.75601, 336.989]],
)  # fmt: skip
TWO_HUMPS = (  # of amplitudes and times (1/f): a row for each impulse, column ζ^j
    [[0.16054, 0.76699, 2.26560, -1.22750], [0.33911, 0.45081, -2.58080, 1.73650],
     [0.34089, -0.61533, -0.68765, 0.42261], [0.15997, -0.60246, 1.00280, -0.93145]],
    [[0.0, 0.0, 0.0, 0.0], [0.49890, 0.16270, -0.54262, 6.16180],
     [0.99748, 0.18382, -1.58270, 8.17120], [1.49920, -0.09297, -0.28338, 1.85710]],
)  # fmt: skip
THREE_HUMPS = (
    [[0.11275, 0.76632, 3.29160, -1.44380], [0.23698, 0.61164, -2.57850, 4.85220],
     [0.30008, -0.19062, -2.14560, 0.13744], [0.23775, -0.73297, 0.46885, -2.08650],
     [0.11244, -0.45439, 0.96382, -1.46000]],
    [[0.0, 0.0, 0.0, 0.0], [0.49974, 0.23834, 0.44559, 12.4720],
     [0.99849, 0.29808, -2.36460, 23.3990], [1.49870, 0.10306, -2.01390, 17.0320],
     [1.99960, -0.28231, 0.61536, 5.40450]],
)  # fmt: skip
SMOOTHERS = {  # length in periods, and the weights' polynomial in T / length, highest power first
    "smooth_zv": (0.8025, [-118.42653, 5.8618855, 29.52796, -1.4654714, 0.019668332]),
    "smooth_mzv": (0.95625, [-1906.7176, 125.88928, 698.02, -37.75923, -62.187624, 1.5717278,
                             1.713118]),
    "smooth_ei": (1.06625, [-1797.0489, 120.53106, 669.6653, -35.719757, -62.493883, 1.396748,
                            1.8482769]),
    "smooth_2hump_ei": (1.14875, [-22525.884, 2524.826, 10554.228, -1051.7784, -1475.9147,
                                  121.21779, 57.956032, -4.0187064, 0.83757848]),
}  # fmt: skip


def _ei(damping: float, v_tol: float = 0.05) -> Impulses:
    first, last, time = (float(_polynomial(v_tol, _polynomial(damping, c))) for c in EI)
    periods = np.array([0.0, time, 1.0]) / _root_and_decay(damping)[0]
    return [first, 1.0 - first - last, last], periods


def _polynomial(x: float, rows: Any) -> Any:
    """Return the sum of rows[k]·x^k."""
    return np.polyval(rows[::-1], x)  # numpy.polynomial takes 20 ms to import


def _humps(damping: float, table: tuple[list[list[float]], list[list[float]]]) -> Impulses:
    amplitudes, times = (_polynomial(damping, np.transpose(rows)) for rows in table)
    return amplitudes, times


def _smoother(_: float, name: str) -> Impulses:
    """Return a polynomial as 64 impulses in the middle of as many intervals."""
    length, weights = SMOOTHERS[name]
    T = (np.arange(64) + 0.5) / 64.0 - 0.5
    return np.maximum(np.polyval(weights, T), 0.0), length * T


KINDS = {
    "zv": Kind(partial(_zv, more=0)),
    "mzv": Kind(_mzv, parameters=(("n", int), ("t", float))),
    "ei": Kind(_ei, 0.4, (("v_tol", float),)),
    "2hump_ei": Kind(partial(_humps, table=TWO_HUMPS), 0.3),
    "3hump_ei": Kind(partial(_humps, table=THREE_HUMPS), 0.2),
    **{f"zv{'d' * more}": Kind(partial(_zv, more=more)) for more in (1, 2, 3)},
    **{name: Kind(partial(_smoother, name=name)) for name in SMOOTHERS},
}
WITH_PARAMETERS = ("mzv(n=4,t=0.9)", "mzv(n=5,t=1.1)")  # those that Klipper's manual names
NAME = re.compile(r"(\w+)(?:\s*\((.*)\))?")


def compared() -> tuple[str, ...]:
    """Return the names of the shapers that a comparison tries."""
    return (*KINDS, *WITH_PARAMETERS)


def _parsed(name: str) -> tuple[Kind, dict[str, float]]:
    """Return the kind of a shaper and its parameters. Raises HframeError."""
    match = NAME.fullmatch(name)
    if match is None or match[1] not in KINDS:
        raise HframeError(f"unknown shaper {name!r}: choose one of {', '.join(KINDS)}")
    kind = KINDS[match[1]]
    types, found = dict(kind.parameters), dict[str, float]()
    for part in filter(None, (match[2] or "").split(",")):
        key, _, value = (text.strip() for text in part.partition("="))
        try:
            found[key] = types[key](value)
        except (KeyError, ValueError):
            known = ", ".join(f"{key}=…" for key in types) or "none"
            raise HframeError(f"{name}: {part.strip()!r} is not one of {known}") from None
    return kind, found
