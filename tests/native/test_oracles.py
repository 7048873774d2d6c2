"""Compiled loops give what plain numpy does."""

import numpy as np
import pytest

from hframe_post.firmware.klipper.code import StreamLimits
from hframe_post.native import judging, planning, ramps
from hframe_post.native.planning import find_runs
from hframe_post.printer.settings import Printer
from tests.native import oracles
from tests.paths import walk

SEEDS = range(30)


@pytest.mark.parametrize("seed", SEEDS)
def test_klipper_feeds(paper: Printer, seed: int) -> None:
    """Some segments are straight on or straight back, and some are too short for their time."""
    rng = np.random.default_rng(seed)
    k, power, lifts = int(rng.integers(1, 300)), rng.uniform(-4.0, 1.0), rng.random() < 0.5
    limits = StreamLimits.from_limits(paper.limits, paper.motors, paper.kinematics).row
    moves = rng.normal(0.0, 10.0**power, (k, 4)).round(3) * (1.0, 1.0, lifts, 0.04)
    moves[rng.random(k) < 0.2] = moves[0] * rng.choice([1.0, -1.0])
    moves[:, 0] = np.where(moves[:, 0] == 0.0, 0.001, moves[:, 0])
    at = np.cumsum(np.vstack([np.zeros(4), moves]), axis=0)
    rest, before = rng.random(k + 1) < rng.choice([0.0, 0.1]), float(rng.choice([0.0, 60.0]))
    given = at, 1e-3 * np.ceil(rng.uniform(0.0, 200.0, k)), rest, before, np.inf, limits
    for one, other in zip(ramps.klipper_feeds(*given, 600.0), oracles.klipper_feeds(*given, 600.0),
                          strict=True):  # fmt: skip
        assert one.tobytes() == other.tobytes()
    v = rng.uniform(0.1, 700.0, k)
    taken = ramps.klipper_durations(at, v, rest, before, np.inf, limits)
    expected = oracles.Ramped.from_moves(np.diff(at, axis=0), rest, limits).durations(v, before)
    assert taken.tobytes() == expected.tobytes()


@pytest.mark.parametrize("seed", SEEDS)
def test_ways_to_the_path(seed: int) -> None:
    """As long as the nozzle is near, no way to another piece of the path is shorter."""
    rng = np.random.default_rng(seed)
    path = walk(rng, 300)
    nozzle = path + rng.normal(0.0, 1e-4, path.shape)
    at = np.arange(0, 300, 2)
    off = judging.deviation(path, judging.count_turns(path), nozzle, 0, at, 24)
    shortest = oracles.distances(path, nozzle, at, 24)
    found = np.sqrt(np.square(off).sum(axis=1))
    assert (found >= shortest - 1e-12).all()
    assert np.sqrt(np.square(found).mean() / np.square(shortest).mean()) < 1.05


@pytest.mark.parametrize("seed", SEEDS)
def test_phases_reach_the_ends_of_runs_at_their_speeds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 60))
    moves = np.column_stack([
        10.0 ** rng.uniform(-3.0, 1.5, n), rng.uniform(5.0, 300.0, n),
        rng.uniform(300.0, 2e4, n), np.full(n, 0.01), np.zeros(n),
    ])  # fmt: skip
    caps = rng.uniform(0.0, 300.0, n + 1) * (rng.random(n + 1) < 0.9)
    caps[1:-1] = np.minimum(caps[1:-1], np.minimum(moves[1:, 1], moves[:-1, 1]))
    caps[0] = 0.0
    s, ends, speed = find_runs(moves, caps, 1e6, 1e4, 0.0)
    length = np.diff(s[ends])
    for low, high in ((speed[:-1], speed[1:]), (speed[1:], speed[:-1])):
        reached = oracles.reachable_speed(low, length, np.full(len(length), 2e4), 1e6)
        assert (high <= reached * (1.0 + 1e-6) + 1e-9).all()
    run, most = moves[ends[:-1], 1:3].T.copy()
    t, j, _ = planning.profiles(speed[:-1], speed[1:], length, run, most, 1e4, 1e6)
    _, _, steps = oracles.integrate(t, j, speed[:-1])
    straight = planning.misses(t, j, speed[:-1], length)
    assert np.abs(steps.sum(axis=1) - length)[~straight].max(initial=0.0) < 1e-6
