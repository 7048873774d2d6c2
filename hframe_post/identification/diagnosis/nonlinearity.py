"""Tell whether a printer is nonlinear, and why, from the harmonics of its sweeps.

Each cause is simulated on the sweep of the linear printer; the harmonics that it would make are
compared with those that were measured.

===========  ================================================  ===============
cause        force, or motion                                  seen through
===========  ================================================  ===============
friction     −sign(v), on the carriage                         1 − G
backlash     the motor's path, less the play b, less that path s²·G
hardening    e³, of a belt stretched by e = u − x              1 − G
one-sided    e²                                                1 − G
===========  ================================================  ===============

u is the command; x and v = dx/dt are the linear printer's response to it; G is that printer without
its delay. Friction and backlash grow alike with frequency. They differ in phase, since the carriage
turns around later than the motor, and where the motion becomes as small as the play.

Stepper motors make harmonics, too: 1 to 2.6 % of the response with steps of 20 µm, more than 10 µm
of backlash. But their phases depend on the position within a step, and the sweep's slow sway
carries it across many steps, so they correlate with no cause. A harmonic counts as far as it does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.recordings.alignment import acceleration
from hframe_post.identification.responses.frequency_response import (
    LOWEST_HZ,
    Distortion,
    Harmonics,
    harmonics,
)

ORDER = {"friction": 3, "backlash": 3, "hardening": 3, "one-sided": 2}  # of its main harmonic
ADVICE = {
    "friction": "Coulomb friction of {size:.0f} mm/s². Clean and grease the rails, and check that "
    "no belt is too tight",
    "backlash": "backlash of {microns:.0f} µm. Look for a loose belt, pulley or carriage",
    "hardening": "a belt or mount that gets stiffer the harder it is pulled. Look for what "
    "is loose",
    "one-sided": "a belt or mount that is stiffer in one direction. Set the tension of the belts",
}


@dataclass(frozen=True, slots=True)
class LinearPrinter:
    """The linear part of an axis.

    response: of hz (k,), as measured, with sensor gain and delay (s).
    """

    response: Callable[[Array], Complex]
    gain: float
    delay: float


@dataclass(frozen=True, slots=True)
class AxisSweeps:
    """The sweeps of an axis: each run's command (m,) in mm with its harmonics, and the model."""

    runs: Sequence[tuple[Array, Harmonics]]
    printer: LinearPrinter


@dataclass(frozen=True, slots=True)
class Nonlinearity:
    """The most likely cause.

    shares: the harmonics' share of each nonlinear axis's amplitude. size: mm/s² of friction, mm of
    play. distortions: of the measured response, by axis.
    """

    cause: str
    shares: dict[str, float]
    size: float
    distortions: dict[str, Distortion]

    @property
    def share(self) -> float:
        return max(self.shares.values())

    @property
    def message(self) -> str:
        advice = ADVICE[self.cause].format(size=self.size, microns=1e3 * self.size)
        where = " and ".join(f"{100 * s:.1f} % in {axis}" for axis, s in self.shares.items())
        return (
            f"the printer is not linear: it responds to a sine with harmonics ({where}). The "
            f"likely cause is {advice}"
        )


def find_nonlinearity(axes: Mapping[str, AxisSweeps], step: float) -> Nonlinearity | None:
    """Return what the harmonics tell, or None for a linear printer.

    step: mm of belt that a motor step moves.
    """
    shares: dict[str, float] = {}
    matches: dict[str, dict[str, _Match]] = {}
    for name, axis in axes.items():
        measured = Harmonics.from_runs([one for _, one in axis.runs])
        by_order = {order: measured.share(order) for order in (2, 3)}
        matches[name] = {cause: _match(axis, cause, by_order[ORDER[cause]]) for cause in ORDER}
        explained = {
            c: by_order[ORDER[c]] * match.correlation for c, match in matches[name].items()
        }
        best = max(explained, key=lambda cause: explained[cause])
        whole = float(np.hypot(by_order[2], by_order[3]))
        # A correlation with steps is 0.05 to 0.25, with a true cause 0.7 to 1. Harmonics above
        # 2 per mm of step cannot come from steps at all.
        if explained[best] > max(0.004, 0.5 * by_order[ORDER[best]]) or whole > 2.0 * step:
            shares[name] = whole
    if not shares:
        return None
    scores = {
        cause: sum((shares[name] * matches[name][cause].correlation) ** 2 for name in shares)
        for cause in ORDER
    }
    cause = max(scores, key=lambda name: scores[name])
    size = max(matches[name][cause].size for name in shares)
    return Nonlinearity(
        cause, shares, size, {name: match[cause].distortion for name, match in matches.items()}
    )


@dataclass(frozen=True, slots=True)
class _Match:
    correlation: float
    size: float
    distortion: Distortion


def _match(axis: AxisSweeps, cause: str, share: float) -> _Match:
    """Simulate a cause on up to two runs and compare the harmonics, without their noise.

    share: of the harmonic in the response's amplitude.
    """
    order = ORDER[cause]
    some = axis.runs[:: max(1, -(-len(axis.runs) // 2))]
    sweeps = [(SimulatedSweep(u, axis.printer), acceleration(u)) for u, _ in some]
    measured = Harmonics.from_runs([one for _, one in some])
    used = measured.used(order)
    values = measured.amplitude[used, order - 1]
    # the effect of play is not proportional to it, so simulate it again with better guesses
    size, rounds = (0.01, 3) if cause == "backlash" else (1.0, 1)
    scale = 0.0
    for _ in range(rounds):
        size *= scale or 1.0
        responses = [harmonics(u, sweep.acceleration(cause, size)) for sweep, u in sweeps]
        simulated = Harmonics.from_runs([response for response in responses if response])
        shape = simulated.amplitude[used, order - 1]
        power = float(np.vdot(shape, shape).real)
        along = float(np.vdot(shape, values).real)
        scale = max(along / power, 0.0) if power else 0.0
    first = float(np.linalg.norm(measured.amplitude[used, 0]))
    length = share * first * np.sqrt(power)
    correlation = float(np.clip(along / length, 0.0, 1.0)) if length else 0.0
    # A square has no first harmonic: take the second for its size.
    added = scale * simulated.amplitude[:, 1 if order == 2 else 0]
    # Only backlash is subtracted from the response. It makes the response smaller, as a sensor
    # gain would. Friction also turns its phase and acts in a print, too; a belt's stiffness does
    # not matter in slow motion.
    certain = 1.0 - float(np.sqrt(1.0 - correlation**2)) if cause == "backlash" else 0.0
    return _Match(correlation, size * scale, _distortion(measured, added, certain))


def _distortion(measured: Harmonics, added: Complex, certain: float) -> Distortion:
    """Return the share of ``added`` (w,) in the sweep's own frequency, averaged over 1 Hz."""
    inside = measured.hz > LOWEST_HZ
    hz, share = measured.hz[inside], (added / measured.amplitude[:, 0])[inside]
    bins = np.floor(hz)
    filled = np.unique(bins)
    return Distortion(
        np.array([hz[bins == k].mean() for k in filled]),
        np.array([share[bins == k].mean() for k in filled]),
        certain,
    )


class SimulatedSweep:
    """A sweep of the linear printer to which a cause is added.

    command (m,): mm every 1 ms, along the swept axis.
    """

    def __init__(self, command: Array, printer: LinearPrinter) -> None:
        self._m = len(command)
        tail = 2000  # samples in which the response dies away
        self._n = next_fast_len(self._m + tail, real=True)
        hz = rfftfreq(self._n, TS)
        self._s: Complex = 2j * np.pi * hz
        low, high = 240.0, 300.0  # sensors are not flat above
        self._sensor = np.clip((high - hz) / (high - low), 0.0, 1.0)
        late = np.exp(-self._s * printer.delay)
        self._G = printer.response(hz) / (late * printer.gain * np.sinc(hz * TS) ** 2)
        self._output = self._sensor * late * printer.gain
        self._u = np.zeros(self._n)
        self._u[: self._m] = command - command[0]
        self._U = rfft(self._u)

    def acceleration(self, cause: str, size: float) -> Array:
        """Return what the cause adds to the sensor's acceleration (m,), mm/s².

        size: mm of play; of other causes a factor.
        """
        if cause == "backlash":
            change = with_backlash(self._u, size) - self._u
            return self._recorded(change, self._s**2 * self._G)
        return size * self._recorded(self._force(cause), 1.0 - self._G)

    def _force(self, cause: str) -> Array:
        if cause == "friction":
            v = irfft(self._s * self._G * self._sensor * self._U, self._n)
            # a sample in which v passes through 0 counts by its share of either sign
            return np.asarray(-np.clip(v / (0.5 * np.abs(np.gradient(v)) + 1e-9), -1.0, 1.0))
        e = irfft((1.0 - self._G) * self._U, self._n)
        return np.asarray(e**3 if cause == "hardening" else e**2)

    def _recorded(self, signal: Array, path: Complex) -> Array:
        return np.asarray(irfft(rfft(signal) * path * self._output, self._n)[: self._m])


def with_backlash(u: Array, play: float) -> Array:
    """Return the position (n,) of a carriage that the motor u (n,) pushes with ``play``, mm.

    y_k = min(max(y_{k−1}, u_k − b/2), u_k + b/2). Such steps in a row make one of the same form,
    so they are combined by doubling.
    """
    low, high = u - play / 2.0, u + play / 2.0
    low[0] = high[0] = u[0]
    span = 1
    while span < len(u):
        floor, ceiling = low[span:].copy(), high[span:].copy()
        low[span:] = np.clip(low[:-span].copy(), floor, ceiling)
        high[span:] = np.clip(high[:-span].copy(), floor, ceiling)
        span *= 2
    return low
