"""What one filter of the plant gives around a stop, known and by the splines beside it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hframe_post.arrays import Array
from hframe_post.model.stop_filters import Lifted, judged
from hframe_post.model.stop_judged import AFTER, BEFORE, BESIDE, BEYOND

DURATIONS = 32  # of holds, that are remembered


class Response:
    """Outputs at the judged samples (r,): before the hold, after it, and in it.

    N_before, N_after (BESIDE, k): the splines beside the hold, whose own place is one more.
    """

    def __init__(self, G: Lifted, N_before: Array, N_after: Array) -> None:
        self._G = G
        first, O, self._A, self._R = G.lifted(BESIDE)
        later, ringing, _, _ = G.lifted(BESIDE + BEYOND)
        self._G_before, self._O_before = first[BEFORE], O[BEFORE]
        self._G_after, self._O_after = later[AFTER], ringing[AFTER]
        self._before = self._G_before @ N_before
        self._after = self._G_after[:, :BESIDE] @ N_after
        self._reached = self._R @ N_before
        self.by_splines = lru_cache(maxsize=DURATIONS)(self._by_splines)

    def _by_splines(self, n: int) -> Array:
        """Outputs (r, 2k + 1) by splines before, hold and splines after, of a hold of n."""
        k = self._before.shape[1]
        until, around = len(BEFORE), len(BEFORE) + len(AFTER)
        state = np.zeros((len(self._A), 2 * k + 1))  # when the hold begins
        state[:, :k] = self._reached
        by_p = np.zeros((around + len(judged(n)), 2 * k + 1))
        by_p[:until, :k] = self._before
        if n:
            by_state, by_input = self._G.held_output(n)
            by_p[around:] = by_state @ state
            by_p[around:, k] = by_input
        ring, step = self._G.standing(n)
        state = ring @ state
        state[:, k] = step
        by_p[until:around] = self._O_after @ state
        by_p[until:around, k + 1 :] += self._after
        return by_p

    def known(self, s: Array, before: Array, h: float, after: Array, n: int) -> Array:
        """Outputs (r,) from state s by the inputs before, in and after a hold of n samples at h."""
        state = self._A @ s + self._R @ before
        outputs = [self._G_before @ before + self._O_before @ s]
        ring, step = self._G.standing(n)
        outputs.append(self._G_after @ after + self._O_after @ (ring @ state + step * h))
        if n:
            by_state, by_input = self._G.held_output(n)
            outputs.append(by_state @ state + by_input * h)
        return np.concatenate(outputs)
