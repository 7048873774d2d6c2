"""Linear recursions, many steps in one matrix product."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array

STEPS_AT_ONCE = 8  # of a recursion, in one matrix product


class Recursion:
    """The states of s[k+1] = A s[k] + w[k], many steps in one matrix product.

    Within STEPS_AT_ONCE steps the states are a product with the lower block triangle of
    A^(i−1−k); only such groups follow one another.
    """

    def __init__(self, A: Array) -> None:
        n, d = STEPS_AT_ONCE, len(A)
        self._powers = [np.linalg.matrix_power(A, k) for k in range(n + 1)]
        self._from_start = np.hstack([power.T for power in self._powers])
        triangle = np.zeros((n, d, n + 1, d))  # w[k] to s[i]
        for i in range(1, n + 1):
            for k in range(i):
                triangle[k, :, i] = self._powers[i - 1 - k].T
        self._forced = triangle.reshape(n * d, (n + 1) * d)

    def run(self, W: Array, state: Array) -> tuple[Array, Array]:
        """States before each of the steps W (n, d), same shape, and the one after the last."""
        n, d = W.shape
        groups = -(-n // STEPS_AT_ONCE)
        padded = np.zeros((groups, STEPS_AT_ONCE * d))
        padded.reshape(groups * STEPS_AT_ONCE, d)[:n] = W
        states = (padded @ self._forced).reshape(groups, STEPS_AT_ONCE + 1, d)
        starts = np.empty((groups, d))
        for group, last in enumerate(states[:, -1]):
            starts[group] = state
            state = self._powers[-1].dot(state)
            state += last
        states += (starts @ self._from_start).reshape(states.shape)
        full, part = divmod(n, STEPS_AT_ONCE)
        after = states[full, part] if part else state
        return states[:, :-1].reshape(groups * STEPS_AT_ONCE, d)[:n], after
