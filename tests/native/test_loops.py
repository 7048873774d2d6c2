"""Compiled loops give what plain numpy does, and refuse what they cannot take."""

import importlib
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post import native
from hframe_post.native import kernels
from hframe_post.native.block_times import Stepper, block_times, step_times
from hframe_post.native.linear import product, pseudo_inverse, recursion
from hframe_post.native.planning import follow, path_lengths, profiles
from hframe_post.native.whole_steps import Blocks
from tests.marlin.planner import Block, Build, development, released

seeds = st.integers(0, 2**32 - 1)
STILL = np.zeros(4, dtype=np.int64)


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
    np.testing.assert_allclose(recursion(A.T, W, s), expected, atol=1e-12)


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


@pytest.mark.parametrize(
    ("build", "other"), [("2.0", 0.0), ("2.1", 0.0), ("2.1 curved", 0.02), ("2.1-dev", 0.01)]
)
def test_steps_are_made_when_a_board_makes_them(build: str, other: float) -> None:
    """With each kind of timer, on blocks too short for their ramps, and at their own rate.

    other: share of the ticks in which the simulation rounds a ramp's top another way.
    """
    rng = np.random.default_rng(0)
    generation, *curved = build.split()
    ticks = development if generation == "2.1-dev" else released
    different = made = 0
    for _ in range(15):
        k = int(rng.integers(1, 41))
        n = np.ceil(10.0 ** rng.uniform(0.0, 2.5, k))
        rate = np.ceil(10.0 ** rng.uniform(2.1, 4.5, k))
        begin, end = rate * np.minimum(rng.uniform(0.0, 1.5, (2, k)), 1.0)
        blocks = Blocks(n, n, 10.0 ** rng.uniform(4.0, 7.0, k))
        timer = bool(rng.random() < 0.5), float(rng.choice([0.0, 4e4]))
        board = Build(1.0, 1.0, 1.0, planner=generation, s_curve=bool(curved))
        board.extra_tick, board.smoothing_hz = timer
        ahead = {"2.0": 0.0, "2.1": 1.0, "2.1-dev": 0.5}[generation]
        stepper = Stepper(board.timer_hz, *timer, ahead, ahead == 0.5, bool(curved))
        drawn = blocks, begin, rate, end, stepper
        steps = step_times(*drawn)
        ends = steps[np.cumsum(n).astype(int) - 1]
        np.testing.assert_allclose(ends, np.cumsum(block_times(*drawn)), 1e-10)
        rows = zip(n, rate, blocks.a, begin, end, strict=True)
        expected = np.concatenate([
            ticks(Block(STILL, STILL, int(n), n, rate, a, 0.0, 0.0, begin, end), board)
            for n, rate, a, begin, end in rows
        ])  # fmt: skip
        found = np.rint(np.diff(steps, prepend=0.0) * board.timer_hz)
        different += int(np.count_nonzero(found != expected))
        made += len(found)
    assert different <= other * made


def test_an_argument_of_another_kind_layout_or_length_is_an_error() -> None:
    xyze, path, text = np.zeros((2, 4)), np.zeros((2, 2)), np.zeros(4, np.uint8)
    right = [xyze, path, 2, path, np.zeros(8), np.eye(2), 1.0, np.zeros(4)]
    frozen = np.zeros(4)
    frozen.flags.writeable = False
    of_another_kind = {
        0: (xyze.astype(np.float32), xyze.tolist(), 1.0, None, b"0", text),
        2: (2.0, path),
        7: (frozen, np.zeros(8)[::2], np.zeros(4, np.int64)),
    }
    of_another_length = {
        0: (xyze[:1],), 2: (0, -1, 1 << 40, 1 << 70, -(1 << 70)), 7: (np.zeros(3),)
    }  # fmt: skip
    assert kernels.safe(*right) == 1
    for error, wrong in ((TypeError, of_another_kind), (ValueError, of_another_length)):
        for k, values in wrong.items():
            for value in values:
                with pytest.raises(error, match=f"argument {k} of safe"):
                    kernels.safe(*right[:k], value, *right[k + 1 :])
    for count in (0, len(right) - 1):
        with pytest.raises(TypeError, match="must be given"):
            kernels.safe(*right[:count])
    for more in (1, 100):
        with pytest.raises(TypeError, match="argument"):
            kernels.safe(*right, *[1] * more)


def test_new_arrays_are_as_long_as_the_arguments_and_the_result_ask() -> None:
    """Arrays with gaps are read, too."""
    s, points = np.array([0.0, 1.0, 2.0]), np.arange(24.0).reshape(3, 8)[:, ::2]
    xyze, line = np.empty((4, 4)), np.empty(4, np.int64)
    follow(s, points, np.array([7, 0, 9])[::2], np.array([0.5, 0.0, 1.5, 2.0]), xyze, line)
    np.testing.assert_array_equal(line, [7, 7, 9, 9])
    np.testing.assert_allclose(xyze, points[0] + np.outer([4.0, 0.0, 12.0, 16.0], np.ones(4)))
    assert follow(s, points, line, s[:0], xyze[:0], line[:0]) == 0
    assert [path_lengths(np.ones((6, 1)), 0, n, 1.0).shape for n in (5, 0)] == [(5,), (0,)]
    v, length, cruise, most = np.array([[5.0, 5.0], [9.0, 0.02], [5.0, 100.0], [1e3, 1e5]])
    t, j, others = profiles(v, v, length, cruise, most, 1e7)
    assert t.shape == j.shape == (2, 7)
    assert others.tolist() == [1]
    with pytest.raises(ValueError, match="argument 0 of follow must have 2 items or more"):
        follow(s[:1], points, line, s, xyze, line)


@pytest.mark.skipif(sys.platform != "linux", reason="gcc's warnings")
def test_no_compiler_warns() -> None:
    flags = [
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-fsyntax-only",
        "-DPy_LIMITED_API=0x030B0000",
    ]
    sources = Path(native.__file__).parent.glob("*.c")
    subprocess.run(["gcc", *flags, *sources], check=True)


@pytest.mark.parametrize("name", ["missing", "another version"])
def test_missing_loops_say_what_to_do(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found = None if name == "missing" else ModuleType("_kernels")
    if found:
        found.BUILT_FOR = native.BUILT_FOR - 1  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "hframe_post.native._kernels", found)
    with pytest.raises(ImportError, match="pip install -e"):
        importlib.reload(native)
    monkeypatch.undo()
    importlib.reload(native)
