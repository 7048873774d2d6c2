"""The flow out of the nozzle, which follows the extruder late: a filter of first order in pressure.

    K dq/dt + q = d(E + A)/dt

q is the flow (filament, mm/s), K the time that pressure advance is set to, A how far the extruder
is ahead. Retractions are left out: they take back what they give. The simplest model is also the
best that measurements of step responses support; see docs/identify.md.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from hframe_post.arrays import TS, Array, E
from hframe_post.model.advance import extruding
from hframe_post.native.linear import recursion


class Melt:
    """What comes out along one stretch."""

    def __init__(self) -> None:
        self._held = 0.0  # mm of filament by which the hot end is compressed
        self._ahead = 0.0  # A at the last sample

    def laid(self, path: Array, advance: Array | None) -> Array:
        """Return the mm of filament (n,) that come out in the steps of a path (n + 1, 4).

        advance (n, 2): A and K at the ends of the steps; None: both are 0.
        """
        fed = np.where(extruding(path), np.diff(path[:, E]), 0.0)
        if advance is None:
            fed[0] += self._held
            self._held = self._ahead = 0.0
            return fed
        ahead, K = advance.T
        fed += np.diff(ahead, prepend=self._ahead)
        self._ahead = float(ahead[-1])
        cuts = [0, *(np.flatnonzero(np.diff(K)) + 1).tolist(), len(K)]
        parts = pairwise(cuts)
        return np.concatenate([self._part(fed[a:b], float(K[a])) for a, b in parts])

    def _part(self, fed: Array, K: float) -> Array:
        """Return what comes out in steps that feed this much, with one K."""
        kept = np.exp(-TS / K) if K else 0.0
        fed[0] += self._held
        laid = recursion(np.array([[kept]]), (1.0 - kept) * fed[:, None], np.zeros(1))[1:, 0]
        self._held = float(laid[-1]) * kept / (1.0 - kept)
        return laid
