"""Every compiled loop gives the same bits as its numpy version, and so does the whole tool."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hframe_post import native
from hframe_post.arrays import Array, Integers
from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.pipeline import Options
from hframe_post.firmware.klipper import segments
from hframe_post.native import Kernel
from hframe_post.planner import profiles, sampling
from hframe_post.prediction.predict import deviation
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Plan
from hframe_post.writers.stream import digits
from tests.conftest import SAMPLES
from tests.random_paths import wander

seeds = st.integers(0, 2**32 - 1)
thorough = settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def same(one: Array | Integers, other: Array | Integers) -> None:
    assert one.dtype == other.dtype
    assert one.shape == other.shape
    assert one.tobytes() == other.tobytes()


def in_numpy(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a function computes without the compiled loops."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "built", lambda: None)
        return function(*arguments)


@thorough
@given(seeds, st.integers(1, 400), st.floats(-6.0, -1.0), st.booleans(), st.floats(1e-3, 0.1))
def test_decimation(
    compiled: None, seed: int, n: int, power: float, coarse: bool, tolerance: float
) -> None:
    """Rounded points have many chords with equal errors."""
    points, forced = wander(seed, n, power)
    points = points.round(3) if coarse else points
    ends = segments.breakpoints(points, forced, tolerance)
    same(ends, segments._breakpoints(points, forced, tolerance))
    same(segments.fitted(points, ends), segments._fitted(points, ends))


def walk(rng: np.random.Generator, n: int) -> Array:
    """Return a path (n, 2) of straight lines with some corners, curves and standstill."""
    velocity = np.repeat(rng.normal(0.0, 0.1, (n // 20 + 1, 2)), 20, axis=0)[:n]
    velocity += rng.normal(0.0, 0.01, (n, 2)) * (rng.random((n, 1)) < rng.choice([0.0, 0.1, 1.0]))
    velocity[: int(rng.integers(0, n))] *= rng.choice([0.0, 1.0])
    return np.cumsum(velocity, axis=0)


@thorough
@given(seeds, st.integers(1, 600), st.integers(1, 4), st.floats(-5.0, 0.5))
def test_deviation(compiled: None, seed: int, n: int, every: int, power: float) -> None:
    rng = np.random.default_rng(seed)
    path = walk(rng, n)
    at = np.arange(int(rng.integers(0, n)), n, every)
    actual = path[at] + rng.normal(0.0, 10.0**power, (len(at), 2))
    plain = in_numpy(deviation, path, actual, at)
    same(deviation(path, actual, at), plain)


@thorough
@given(seeds, st.integers(1, 40), st.integers(0, 500))
def test_sampling(compiled: None, seed: int, n: int, first: int) -> None:
    rng = np.random.default_rng(seed)
    table = rng.normal(0.0, 10.0, (6, n))
    table[1] = rng.exponential(0.02, n)
    table[0] = np.cumsum(table[1]) - table[1]
    phases, end = profiles.Phases(table), float(rng.uniform(0.1, 10.0))
    same(phases.path(first, 400, end), in_numpy(phases.path, first, 400, end))
    s = np.concatenate([[0.0], np.cumsum(rng.exponential(1.0, n))])
    points, nothing = rng.normal(0.0, 100.0, (n + 1, 4)), np.zeros(0)
    plan = Plan(np.arange(n), points, s, np.zeros(0, np.int64), *(nothing,) * 3, ())
    lengths = np.sort(rng.uniform(0.0, s[-1], 300)) + rng.normal(0.0, 1e-9, 300)
    lengths = np.concatenate([np.clip(lengths, 0.0, s[-1]), s])  # decreasing once, too
    xyze, move = sampling._follow(plan, lengths)
    plain_xyze, plain_move = in_numpy(sampling._follow, plan, lengths)
    same(xyze, plain_xyze)
    same(move, plain_move)


def test_the_whole_tool(
    paper: Printer, library: dict[str, Kernel], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compare text and report for the first layers of a slice."""
    lines = (SAMPLES / "cube.gcode").read_bytes().splitlines(keepends=True)[:1200]
    options = Options("racking", ("none", "racking"))
    results = []
    for found in (None, library):
        monkeypatch.setattr(native, "built", lambda found=found: found)
        conversion = GcodeConversion(lines, paper, options)
        text = b"".join(piece for piece in conversion if isinstance(piece, bytes))
        results.append((text, conversion.report().as_text()))
    assert results[0] == results[1]


def test_another_type_or_layout_is_an_error(library: dict[str, Kernel]) -> None:
    points, forced = wander(1, 10, -2.0)
    room = np.empty(11, np.int64), np.empty((3, 11)), np.empty(11, np.uint8)
    for wrong in (points.astype(np.float32), points.T, points.tolist()):
        with pytest.raises(ctypes.ArgumentError):
            library["breakpoints"](wrong, forced.view(np.uint8), 11, 0.1, 8, 16, 1e-6, *room)


def test_a_library_of_another_version_is_not_taken(tmp_path: Path) -> None:
    broken = tmp_path / "broken.so"
    broken.write_bytes(b"no library")
    assert native.loaded(broken) is None


@thorough
@given(seeds, st.integers(0, 60), st.integers(1, 9), st.integers(0, 5))
def test_lines(compiled: None, seed: int, n: int, digits_of: int, places: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.integers(-(10**digits_of), 10**digits_of + 1, (5, n)) // 10**places * 10**places
    decimals, shown = (4, 5, 6, 5, 4), rng.random((5, n)) < 0.7
    arguments = b"G1", b"XYZEF", values, decimals, shown
    text, ends = digits.command_lines(*arguments)
    plain_text, plain_ends = digits._command_lines(*arguments)
    assert text == plain_text
    same(ends, plain_ends)
