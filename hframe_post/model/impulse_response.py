"""Finite impulse responses, as they are measured: what acceleration does to the nozzle's place.

==========  =====================================================================  ==========
symbol      meaning                                                                unit
==========  =====================================================================  ==========
``c``       command                                                                mm
``a``       its acceleration, a[k] = c[k+1] − 2 c[k] + c[k−1]                      mm/sample²
``q``       deviation that a pulse of a = 1 causes, at j = −lead … m − 1 − lead    samples²
==========  =====================================================================  ==========

The nozzle is at rest·c + q ∗ a, so G(z) = rest + (z − 2 + 1/z)·Q(z). At rest a is zero and G is
``rest`` exactly; at low speed there is no lag. One mode of ω rad/sample has q = −sin(ω j)/ω.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import ArgumentError
from hframe_post.model.transfer_function import TransferFunction

LONGEST = 2000  # samples of a response
AROUND = 4  # samples on either side from which one in between is interpolated


@dataclass(frozen=True)
class ImpulseResponse:
    """A linear response that ends: G(z) = rest + (z − 2 + 1/z)·Σ deviation[i] z^(lead − i).

    deviation (m,): what a pulse of acceleration of 1 mm/sample² adds to the nozzle's place, mm,
    from ``lead`` samples before it; in µm, for 1000 mm/s² during 1 ms, these are the same numbers.
    rest: gain at rest, 1 for an axis and 0 for a coupling. Raises ArgumentError unless the numbers
    are finite, 1 ≤ m ≤ LONGEST and 0 ≤ lead < m.
    """

    deviation: Array
    lead: int
    rest: float = 1.0

    def __post_init__(self) -> None:
        deviation = np.array(self.deviation, dtype=float)
        deviation.flags.writeable = False
        object.__setattr__(self, "deviation", deviation)
        if deviation.ndim != 1 or not 1 <= len(deviation) <= LONGEST:
            raise ArgumentError(
                f"deviation must be 1 to {LONGEST} numbers, its shape is {deviation.shape}"
            )
        if not (np.isfinite(deviation).all() and np.isfinite(self.rest)):
            raise ArgumentError("deviation and rest must be finite")
        if not 0 <= self.lead < len(deviation):
            raise ArgumentError(
                f"lead must be from 0 to {len(deviation) - 1}, the last sample of the response; "
                f"it is {self.lead}"
            )

    @classmethod
    def from_transfer_function(cls, G: TransferFunction, m: int, rest: float) -> ImpulseResponse:
        """Return the first m samples of a causal response as they act on acceleration.

        rest: its gain at rest. The response is only complete if it settles within m samples.
        """
        h = G.impulse(max(m - 1, 0))
        h[:1] -= rest
        return cls(np.concatenate([[0.0], np.cumsum(np.cumsum(h))]), 0, rest)

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

    def response(self, omega: Array) -> Complex:
        """Return the complex frequency response at ``omega`` (rad/sample), same shape."""
        omega = np.asarray(omega, dtype=float)
        at = np.arange(len(self.deviation)) - self.lead
        Q = np.exp(-1j * omega.reshape(-1, 1) * at) @ self.deviation
        return np.asarray(self.rest - (2.0 * np.sin(omega / 2.0)) ** 2 * Q.reshape(omega.shape))

    def taps(self, late: int) -> Array:
        """Return the r for which r ∗ b + rest·c(k − late) is the response ``late`` samples later.

        b[k] = c[k] − 2 c[k−1] + c[k−2], so nothing after sample k is needed. late ≥ ahead.
        """
        first = self.lead + 1 - late
        ringing = np.trim_zeros(self.deviation, "b")[max(first, 0) :]
        return np.concatenate([np.zeros(max(-first, 0 if len(ringing) else 1)), ringing])

    def impulse(self, n: int) -> Array:
        """Return the response to a command of 1 at sample 0 only, n samples from −ahead on."""
        h = np.diff(np.pad(self.taps(self.ahead), 2), n=2)
        h = np.pad(h, (0, max(n - len(h), self.ahead + 1 - len(h), 0)))
        h[self.ahead] += self.rest
        return h[:n]

    def stretched(self, factor: float) -> ImpulseResponse:
        """Return the response of a printer whose frequencies are 1/factor times as high.

        q(t/factor)·factor, by polynomials through 2·AROUND samples: G at f is then what it was
        at factor·f. Damping ratios stay.
        """
        if factor == 1.0:
            return self
        lead = int(np.ceil(self.lead * factor))
        last = int((len(self.deviation) - 1 - self.lead) * factor)
        t = np.arange(-lead, min(last, LONGEST - 1 - lead) + 1) / factor + self.lead
        whole = np.floor(t).astype(np.int64)
        q = np.pad(self.deviation, AROUND + 1)
        nodes, part = range(1 - AROUND, AROUND + 1), t - whole
        stretched = np.zeros(len(t))
        for node in nodes:
            weight = np.full(len(t), factor)
            for other in nodes:
                if other != node:
                    weight *= (part - other) / (node - other)
            stretched += weight * q[whole + node + AROUND + 1]
        return replace(self, deviation=stretched, lead=lead)


Linear: TypeAlias = TransferFunction | ImpulseResponse


def transfer_function(G: Linear) -> TransferFunction:
    """Return G if it has poles and zeros. Raises ArgumentError otherwise."""
    if isinstance(G, ImpulseResponse):
        raise ArgumentError(
            "this needs a model of poles and zeros; that of this printer is a measured impulse "
            "response"
        )
    return G
