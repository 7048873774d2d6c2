"""Finite impulse responses, as they are measured: what acceleration does to the nozzle's place.

==========  =====================================================================  ==========
symbol      meaning                                                                unit
==========  =====================================================================  ==========
``c``       command                                                                mm
``v``       its velocity, v[k] = c[k] − c[k−1]                                     mm/sample
``a``       its acceleration, a[k] = c[k+1] − 2 c[k] + c[k−1]                      mm/sample²
``q``       deviation that a pulse of a = 1 causes, at j = −lead … m − 1 − lead    samples²
==========  =====================================================================  ==========

The nozzle is at rest·c − lag·v + q ∗ a, so G(z) = rest − lag·(1 − 1/z) + (z − 2 + 1/z)·Q(z). At
rest v and a are zero and G is ``rest`` exactly; at a constant speed the nozzle is ``lag`` samples
late, by a damper between axis and frame or by a delay. One mode of ω rad/sample has
q = −sin(ω j)/ω.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import ArgumentError
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.native.judging import coarse_filter, finite_filter

LONGEST = 4000  # samples of a response: a bed at 18 Hz whose damping is 0.03 rings for 3400
GAIN_TOLERANCE = {1.0: 1e-4, 0.0: 1e-9}  # of axes, whose roots may be rounded, and couplings


@dataclass(frozen=True)
class ImpulseResponse:
    """A linear response that ends: its deviation, its lag, and how well they are known.

    deviation (m,): what a pulse of acceleration of 1 mm/sample² adds to the nozzle's place, mm,
    from ``lead`` samples before it; in µm, for 1000 mm/s² during 1 ms, these are the same numbers.
    rest: gain at rest, 1 for an axis and 0 for a coupling. lag: samples. drift: standard deviation
    of the factor by which all frequencies will have changed when something is printed. unknown
    (k,): a filter like ``deviation`` without lead, whose gain at each frequency is the standard
    deviation of what is not known of Q there. written: the transfer function that all this was
    computed from, if any. Raises ArgumentError unless the numbers are finite, 1 ≤ m ≤ LONGEST,
    k ≤ LONGEST, 0 ≤ lead < m and 0 ≤ drift < 1.
    """

    deviation: Array
    lead: int
    rest: float = 1.0
    lag: float = 0.0
    drift: float = 0.0
    unknown: Array = field(default_factory=lambda: np.zeros(0))
    written: TransferFunction | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        for name, least in (("deviation", 1), ("unknown", 0)):
            numbers = np.array(getattr(self, name), dtype=float)
            numbers.flags.writeable = False
            object.__setattr__(self, name, numbers)
            if numbers.ndim != 1 or not least <= len(numbers) <= LONGEST:
                raise ArgumentError(
                    f"{name} must be {least} to {LONGEST} numbers, its shape is {numbers.shape}"
                )
            if not np.isfinite(numbers).all():
                raise ArgumentError(f"{name} must be finite")
        deviation = self.deviation
        if not np.isfinite([self.rest, self.lag]).all():
            raise ArgumentError("rest and lag must be finite")
        if not 0.0 <= self.drift < 1.0:
            raise ArgumentError(f"drift must be a share from 0 to below 1, it is {self.drift:g}")
        if not 0 <= self.lead < len(deviation):
            raise ArgumentError(
                f"lead must be from 0 to {len(deviation) - 1}, the last sample of the response; "
                f"it is {self.lead}"
            )

    @classmethod
    def from_mode(cls, hz: float, damping: float) -> ImpulseResponse:
        """Return an axis that rings in one mode, exact for a command of straight lines.

        damping: ratio, above 0 and below 1. Raises ArgumentError if it rings for too long.
        """
        if not (0.0 < hz < 0.5 / TS and 0.0 < damping < 1.0):
            raise ArgumentError(f"a mode of {hz:g} Hz with damping {damping:g} is not a printer's")
        s = 2.0 * math.pi * hz * TS * complex(-damping, math.sqrt(1.0 - damping**2))
        residue = abs(s) ** 2 / (2j * s.imag) / s**2
        q = np.asarray(2.0 * (residue * np.exp(s * np.arange(LONGEST))).real)
        q[0] = 0.0  # a lag begins one sample later
        lasting = np.flatnonzero(np.abs(q) > 1e-3 * np.abs(q).max())  # what is less has settled
        return cls(q[: lasting[-1] + 1], 0, lag=-2.0 * (1.0 / s).real)

    @classmethod
    def from_transfer_function(cls, G: TransferFunction, rest: float) -> ImpulseResponse:
        """Return a causal response as it acts on acceleration, until it has ended.

        rest: its gain at rest. The lag is the response's own. Raises ArgumentError if its gain is
        another, or if it has not ended within LONGEST samples.
        """
        if not abs(G.dc_gain - rest) <= GAIN_TOLERANCE[rest]:
            raise ArgumentError(
                f"gain at rest must be {rest:g}, it is {G.dc_gain:.6g}: a printer at rest stands "
                "at its command"
            )
        lag = G.lag
        h = G.impulse(2 * LONGEST)
        h[0] += lag - G.dc_gain
        h[1] -= lag
        deviation = np.concatenate([[0.0], np.cumsum(np.cumsum(h))])
        left = np.cumsum(np.abs(deviation[::-1]))[::-1]
        # a share of 1e-5 of all deviation is 0.01 µm of a strong acceleration's
        m = max(int(np.count_nonzero(left > 1e-5 * left[0])), 1)
        if m > LONGEST:
            raise ArgumentError(
                f"the response still rings after {LONGEST} ms: its poles are too close to 1"
            )
        return cls(deviation[:m], 0, rest, lag, written=G)

    @cached_property
    def ahead(self) -> int:
        """Return how many samples of the command after a sample its response depends on.

        The acceleration of a sample contains the next one, so this is one more than the lead,
        unless the deviation begins with zeros.
        """
        moving = np.flatnonzero(self.deviation)
        return max(self.lead + 1 - int(moving[0]), 0) if len(moving) else 0

    @property
    def dc_gain(self) -> float:
        """Return the gain at rest, G(z = 1)."""
        return self.rest

    @property
    def doubts(self) -> tuple[ImpulseResponse, ...]:
        """Return responses whose outputs, squared, are the expected squared errors of this one.

        The first is for ``drift``: what ``stretched`` changes, per factor, times the drift, where
        d/df of f·q(t/f) is q − t·dq/dt at f = 1. The second is for ``unknown``.
        """
        doubts = []
        if self.drift:
            q, t = self.deviation, np.arange(len(self.deviation)) - self.lead
            changed = q - t * np.gradient(q) if len(q) > 1 else q
            doubts.append(replace(
                self, deviation=self.drift * changed, rest=0.0, lag=self.drift * self.lag,
                drift=0.0, unknown=np.zeros(0), written=None,
            ))  # fmt: skip
        if len(self.unknown):
            doubts.append(ImpulseResponse(self.unknown, 0, rest=0.0))
        return tuple(doubts)

    def response(self, omega: Array) -> Complex:
        """Return the complex frequency response at ``omega`` (rad/sample), same shape."""
        omega = np.asarray(omega, dtype=float)
        w = -1j * omega.reshape(-1, 1)
        # Σ_r e^(Brw) Σ_c q[Br + c] e^(cw): B + n/B exponentials for each frequency instead of n
        B = 64
        q = np.pad(self.deviation, (0, -len(self.deviation) % B)).reshape(-1, B)
        shifts = np.exp(w * (B * np.arange(len(q)) - self.lead))
        Q = (np.exp(w * np.arange(B)) @ q.T * shifts).sum(axis=1)
        by_velocity = self.lag * (1.0 - np.exp(-1j * omega))
        by_acceleration = (2.0 * np.sin(omega / 2.0)) ** 2 * Q.reshape(omega.shape)
        return np.asarray(self.rest - by_velocity - by_acceleration)

    def taps(self, late: int) -> Array:
        """Return the r for which r ∗ b is what q ∗ a is ``late`` samples later.

        b[k] = c[k] − 2 c[k−1] + c[k−2], so nothing after sample k is needed. late ≥ ahead.
        """
        first = self.lead + 1 - late
        ringing = np.trim_zeros(self.deviation, "b")[max(first, 0) :]
        return np.concatenate([np.zeros(max(-first, 0 if len(ringing) else 1)), ringing])

    def impulse(self, n: int) -> Array:
        """Return the response to a command of 1 at sample 0 only, n samples from −ahead on."""
        h = np.diff(np.pad(self.taps(self.ahead), 2), n=2)
        h = np.pad(h, (0, max(n - len(h), self.ahead + 2 - len(h), 0)))
        h[self.ahead] += self.rest - self.lag
        h[self.ahead + 1] += self.lag
        return h[:n]

    def stretched(self, factor: float) -> ImpulseResponse:
        """Return the response of a printer whose frequencies are 1/factor times as high.

        q(t/factor)·factor and factor·lag: G at f is then what it was at factor·f. Damping ratios
        stay.
        """
        if factor == 1.0:
            return self
        deviation, lead = _stretched(self.deviation, self.lead, factor)
        unknown = _stretched(self.unknown, 0, factor)[0] if len(self.unknown) else self.unknown
        lag = factor * self.lag
        return replace(self, deviation=deviation, lead=lead, lag=lag, unknown=unknown, written=None)

    def damped(self, factor: float) -> ImpulseResponse:
        """Return the response with the damping ratio of its modes times a factor.

        One rate of decay stands for those of all modes: half the inverse of the time around which
        the squared response lies, as for a single mode. The lag stays.
        """
        t = np.maximum(np.arange(len(self.deviation)) - self.lead, 0)
        squared = np.square(self.deviation)
        time = float(squared @ t)
        rate = 0.5 * float(squared.sum()) / time if time > 0.0 else 0.0
        deviation = np.exp((1.0 - factor) * rate * t) * self.deviation
        return replace(self, deviation=deviation, written=None)

    def heavier(self, factor: float) -> ImpulseResponse:
        """Return the response with ``factor`` times the mass behind its modes.

        Frequencies and damping ratios fall by √factor; the lag stays. Of a transfer function each
        pair of roots moves by itself. Raises ArgumentError if it rings for too long.
        """
        if self.written is not None:
            new = ImpulseResponse.from_transfer_function(self.written.heavier(factor), self.rest)
            return replace(new, drift=self.drift, unknown=self.unknown)
        longer = math.sqrt(factor)
        return replace(self.stretched(longer).damped(1.0 / longer), lag=self.lag)


def _stretched(q: Array, lead: int, factor: float) -> tuple[Array, int]:
    """Return q(t/factor)·factor and its lead, by polynomials through 8 samples around it."""
    new = int(np.ceil(lead * factor))
    last = int((len(q) - 1 - lead) * factor)
    t = np.arange(-new, min(last, LONGEST - 1 - new) + 1) / factor + lead
    whole = np.floor(t).astype(np.int64)
    q = np.pad(q, 5)
    nodes, part = range(-3, 5), t - whole
    stretched = np.zeros(len(t))
    for node in nodes:
        weight = np.full(len(t), factor)
        for other in nodes:
            if other != node:
                weight *= (part - other) / (node - other)
        stretched += weight * q[whole + node + 5]
    return stretched, new


class FiniteFilter:
    """An impulse response applied to a stream, its output ``late`` samples late, at least G.ahead.

    state (memory,): the latest samples of the input. Acceleration is filtered, which at rest is
    zero.
    """

    def __init__(self, G: ImpulseResponse, late: int) -> None:
        self._taps = np.ascontiguousarray(G.taps(late)[::-1])  # that of the oldest sample first
        self._rest, self._lag, self._late = G.rest, G.lag, late
        self.memory = max(len(self._taps), late) + 1
        self.state = np.zeros(self.memory)

    def run(self, u: Array) -> Array:
        """Return the output (n,) at the next samples of the input u (n,)."""
        known = np.concatenate([self.state, u])
        self.state = known[len(u) :].copy()
        return self.output(known, len(u))

    def output(self, known: Array, n: int) -> Array:
        """Return the output at the last n samples of the input known (memory or more + n,)."""
        return finite_filter(self._taps, known, n, self._late, self._rest, self._lag)


# ----------------------------------------------------------------------
# A response at half the rate, from every second sample of a command.
#
# Of what a printer does, nothing is above 250 Hz. So q is drawn as a smooth curve through every
# second sample, a sum of bells (1, 4, 6, 4, 1)/8. What a bell makes of accelerations is half the
# second difference, over two samples, of the command's means (1, 2, 1)/4. On two measured Vorons
# the nozzle differs from that of all samples by 0.01 to 0.08 µm RMS where it deviates by 10 to
# 44 µm RMS, in strokes at 5000 mm/s². Hats (1, 2, 1)/2 add 4 % to errors of compensated lines,
# whose corners contain all frequencies.
#
# The bells are those of least squares. Their products with each other have two pairs of poles, and
# the inverse of each is an exponential.

BELL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 8.0
_ROOTS = -14.0 + np.array([1.0, -1.0]) * np.sqrt(128.0)  # of s² + 28 s + 68, s = z + 1/z
POLES = 0.5 * (_ROOTS + np.sqrt(_ROOTS**2 - 4.0))


class CoarseFilter:
    """An impulse response applied to pieces of an input, at half the rate.

    taps (m,): of its bells, the oldest first. past, ahead: samples of the input that are needed
    before a sample and after it.
    """

    def __init__(self, G: ImpulseResponse) -> None:
        self.rest, self.lag = G.rest, G.lag
        decided = 20  # bells on either side of a sample; the next would count for a millionth
        before = 2 * (decided + (G.lead + 1) // 2)  # samples of the curve before the pulse
        begin = before - G.lead
        q = np.pad(G.deviation, (begin, 2 * decided + 2 + (begin + len(G.deviation)) % 2))
        q[before + 1] -= 0.5 * G.lag  # what a speed over two samples has less than one over one
        bells = np.convolve(q, BELL, "same")[::2]
        for pole in POLES:
            weights = pole ** np.abs(np.arange(-decided, decided + 1)) / (pole - 1.0 / pole)
            bells = np.convolve(bells, weights, "same")
        self.taps = np.ascontiguousarray(64.0 * bells[::-1])
        self.ahead = before + 3
        self.past = 2 * len(bells) + 4 - self.ahead

    def output(self, u: Array, first: int, n: int, every: int) -> Array:
        """Return the output at every n-th (``every``, even) of n samples of u, from first on.

        u has ``past`` samples before these and ``ahead`` after them.
        """
        count = -(-n // every)
        own = self.taps, self.ahead, self.rest, self.lag
        return coarse_filter(*own, u, first, count, every)
