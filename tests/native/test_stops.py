"""The least squares of stops in C have the bits of the numpy version with its sums in order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post.arrays import Array
from hframe_post.compensation.stops import StopSolvers
from hframe_post.conversion.pipeline import prepared
from hframe_post.model import stop_problem
from hframe_post.model.linear import product
from hframe_post.model.stop import StopSolver
from hframe_post.model.stop_cost import Stop, Surroundings
from hframe_post.printer.profile import load
from tests.coupled import coupled_plant
from tests.native.comparing import in_numpy, same, seeds, thorough


@pytest.fixture(scope="module", params=["racking", "coupled"])
def solver(request: pytest.FixtureRequest) -> StopSolver:
    printer = load("paper")
    if request.param == "coupled":
        printer = replace(printer, plant=coupled_plant(1, racks=True))
    return StopSolvers(prepared(printer), ["racking"], printer).at(0.0)["racking"]


def by_cholesky(squares: Array) -> Array:
    """Return H⁻¹g of [H g], which becomes [U y] with UᵀU = H, by rows and in order."""
    squares, n = squares.copy(), len(squares)
    for j in range(n):
        squares[j, j:] /= np.sqrt(squares[j, j])
        row = squares[j, j + 1 :]
        squares[j + 1 :, j + 1 :] -= row[:-1, None] * row
    p = squares[:, n]
    for i in reversed(range(n)):
        p[i] /= squares[i, i]
        p[:i] -= squares[:i, i] * p[i]
    return p


@settings(thorough, max_examples=15)
@given(seeds, st.sampled_from([0, 1, 2, 30, 70, 1000]), st.booleans())
def test_stops(compiled: None, solver: StopSolver, seed: int, hold: int, movable: bool) -> None:
    """At speeds and next to edges of the bed that need the bounds."""
    rng, a = np.random.default_rng(seed), 250
    step = np.repeat(rng.normal(0.0, rng.choice([0.01, 0.1, 0.3]), (40, 2)), 20, axis=0)
    step += rng.normal(0.0, 0.01, step.shape) * rng.choice([0.0, 1.0])
    step[a : a + hold] = 0.0
    path = np.concatenate([np.cumsum(step, axis=0), np.tile(step.sum(axis=0), (hold, 1))])
    around = Surroundings(path, rng.choice([0.5, 100.0], 2), rng.random(len(path)) < rng.random())
    before, after = rng.integers(0, 101, 2).tolist()
    stop = Stop(a, a + hold, before, after, movable and hold > 0, a + hold + after + 1)
    before = solver.around.at_rest(np.zeros(2), around.origin)
    before.run(path[: a - 100])
    solved = solver.solve(around, path, before, stop)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stop_problem, "_times", product)
        patch.setattr(stop_problem, "_solved", by_cholesky)
        same(solved, in_numpy(solver.solve, around, path, before, stop))
