"""Linear algebra with sums in order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post.native.linear import product, pseudo_inverse, recursion

seeds = st.integers(0, 2**32 - 1)


@settings(deadline=None)
@given(st.integers(1, 12), st.integers(0, 30), st.integers(1, 20), seeds)
def test_products_take_their_terms_in_order(m: int, k: int, n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(m, k)), rng.normal(size=(k, n))
    expected = np.zeros((m, n))
    for r in range(k):
        expected += np.outer(A[:, r], B[r])
    np.testing.assert_array_equal(product(A, B), expected)
    np.testing.assert_array_equal(product(A[0], B), expected[0])


@settings(deadline=None)
@given(st.integers(0, 40), st.integers(1, 5), st.integers(1, 5), seeds)
def test_recursion_takes_the_steps_one_by_one(m: int, d: int, n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, W, s = rng.normal(size=(n, d)) / (2 * d), rng.normal(size=(m, n)), rng.normal(size=d)
    expected = s
    for row in W:
        expected = np.concatenate([expected, A @ expected[-d:] + row])
    np.testing.assert_allclose(recursion(A, W, s), expected, atol=1e-12)


def test_pseudo_inverse_of_columns_that_are_almost_the_same() -> None:
    rng = np.random.default_rng(1)
    A = rng.normal(size=(60, 12))
    A[:, 7] = A[:, 3] + 1e-8 * rng.normal(size=60)
    inverse = pseudo_inverse(A, 1e12)
    assert inverse is not None
    np.testing.assert_allclose(inverse @ A, np.eye(12), atol=1e-7)
    np.testing.assert_allclose(A @ inverse, (A @ inverse).T, atol=1e-7)


@pytest.mark.parametrize("gap", [0.0, 1e-14])
def test_dependent_columns_have_no_inverse(gap: float) -> None:
    A = np.random.default_rng(2).normal(size=(20, 3))
    A[:, 2] = A[:, 1] * (1.0 + gap)
    assert pseudo_inverse(A, 1e12) is None
    assert pseudo_inverse(0.0 * A, 1e12) is None
