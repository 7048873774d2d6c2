"""A linear response applied to a stream: filters that carry their state from piece to piece.

Each output is a sum over the latest samples (``FiniteFilter``). A response that changes along x is
a mixture (``FilterAlongX``).
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.native.judging import finite_filter, sliding_sums

PIECE = 256  # outputs for which the nodes of a response along x are chosen together


def stream_filter(G: ImpulseResponse, late: int) -> FiniteFilter:
    """Return the filter of G whose output comes ``late`` samples late, at least G.ahead."""
    return FilterAlongX(G, late) if G.elsewhere else FiniteFilter(G, late)


class FiniteFilter:
    """An impulse response applied to a stream, its output ``late`` samples late.

    state (memory,): the latest samples of the input. Acceleration is filtered, which at rest is
    zero.
    """

    def __init__(self, G: ImpulseResponse, late: int) -> None:
        self._taps = np.ascontiguousarray(G.taps(late)[::-1])  # that of the oldest sample first
        self._rest, self._lag, self._late = G.rest, G.lag, late
        self.memory = max(len(self._taps), late) + 1
        self.state = np.zeros(self.memory)

    def run(self, u: Array, x: Array | None = None) -> Array:
        """Return the output (n,) at the next samples of the input u (n,); x: see ``output``."""
        known = np.concatenate([self.state, u])
        self.state = known[len(u) :].copy()
        return self.output(known, u if x is None else x)

    def output(self, known: Array, x: Array) -> Array:
        """Return the output (n,) at the last samples of the input known (memory or more + n,).

        x (n,): place of the nozzle at the outputs, mm, for a response that changes along x.
        """
        return finite_filter(self._taps, known, len(x), self._late, self._rest, self._lag)


class FilterAlongX(FiniteFilter):
    """A response that changes along x, applied to a stream, its output ``late`` samples late.

    The nodes' responses to the whole past are mixed, each as if it had always been there.
    """

    def __init__(self, G: ImpulseResponse, late: int) -> None:
        self._x = np.array([x for x, _ in G.nodes])
        self._lags = np.array([node.lag for _, node in G.nodes])
        each = [node.taps(late)[::-1] for _, node in G.nodes]
        m = max(map(len, each))
        self._each = [np.pad(taps, (m - len(taps), 0)) for taps in each]
        self._rest, self._late = G.rest, late
        self.memory = max(m, late) + 1
        self.state = np.zeros(self.memory)

    def output(self, known: Array, x: Array) -> Array:
        n, memory = len(x), len(self._each[0]) - 1
        before = len(known) - n
        acceleration = np.diff(known[before - memory - 2 :], n=2)
        x = np.clip(x, self._x[0], self._x[-1])
        left = np.clip(np.searchsorted(self._x, x, "right") - 1, 0, len(self._x) - 2)
        share = (x - self._x[left]) / (self._x[left + 1] - self._x[left])
        y = np.zeros(n)
        for a in range(0, n, PIECE):
            piece = slice(a, min(a + PIECE, n))
            nodes, part = left[piece], share[piece]
            for k in range(int(nodes.min()), int(nodes.max()) + 2):
                weight = np.where(nodes == k, 1.0 - part, np.where(nodes == k - 1, part, 0.0))
                around = acceleration[a : piece.stop + memory]
                y[piece] += weight * sliding_sums(self._each[k], around)
        before -= self._late
        y += self._rest * known[before : before + n]
        lag = (1.0 - share) * self._lags[left] + share * self._lags[left + 1]
        y -= lag * np.diff(known[before - 1 : before + n])
        return y
