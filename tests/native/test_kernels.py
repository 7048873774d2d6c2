"""Every compiled loop gives the same bits as its numpy version, and so does the whole tool."""

from __future__ import annotations

import sys
import threading
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hframe_post import native
from hframe_post.arrays import TS, Array, X, Z
from hframe_post.compensation.clamp import Clamp, Clamped
from hframe_post.compensation.guard import Guard, Peaks, _farthest
from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.pipeline import Options
from hframe_post.errors import HframeError
from hframe_post.model.linear import product, recursion, windows_product
from hframe_post.model.plant import Filter, Response
from hframe_post.model.responses import Plants
from hframe_post.planner import lookahead, profiles, sampling
from hframe_post.prediction import picture as picture_module
from hframe_post.prediction.picture import WAYS, Picture
from hframe_post.prediction.predict import Polyline, _moving
from hframe_post.prediction.statistics import Labels
from hframe_post.printer.settings import Printer
from hframe_post.stream.chunks import batches
from hframe_post.stream.types import FileLimits, Moves, Plan, Samples, Standing
from hframe_post.studies.simulation.uncertainty import draws
from tests.conftest import SAMPLES
from tests.coupled import coupled_plant
from tests.native.comparing import in_numpy, same, seeds, thorough
from tests.planner.planning import FREE, LIMITS


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
    nozzle = path + rng.normal(0.0, 10.0**power, (n, 2))

    def deviation() -> Array:
        return Polyline(path).deviation(nozzle[at[0] :], at, int(at[0]))

    same(deviation(), in_numpy(deviation))
    xyze = np.column_stack([path, path])
    for one, other in zip(_moving(xyze, 1, every), in_numpy(_moving, xyze, 1, every), strict=True):
        same(one, other)


@thorough
@given(seeds, st.sampled_from([np.nan, np.inf, 0.01, 5.0, 300.0]), st.booleans())
def test_guard(paper: Printer, compiled: None, seed: int, odd: float, in_z: bool) -> None:
    """Safe or not, the same is known of the command, and the same said of it."""
    rng = np.random.default_rng(seed)
    path = np.tile([150.0, 80.0, 0.2, 0.0], (300, 1))
    path[:, :2] += walk(rng, 300)
    command = path[:, :2] + rng.normal(0.0, 1e-3, (300, 2))
    (path[:, 2:] if in_z else command)[rng.integers(0, 300), 0] += odd
    whole = Samples(0, path, np.arange(300), (), {"racking": command})

    def outcome() -> str | tuple[Peaks, int]:
        guard = Guard(paper.travel, paper.motors, paper.kinematics)
        try:
            for _ in guard.check(batches([whole], 77), "racking"):
                pass
        except HframeError as error:
            return str(error)
        return guard.peaks, _farthest(path, command)

    assert outcome() == in_numpy(outcome)


@pytest.mark.parametrize("coupled", ["not", "racking", "all"])
def test_response(paper: Printer, compiled: None, coupled: str) -> None:
    """The nozzle, and what couplings give for the compensation, in pieces of any length."""
    own = paper.plant
    plant = {"not": own.decoupled(), "racking": own, "all": coupled_plant(1, racks=True)}[coupled]
    command = np.array([200.0, 80.0]) + walk(np.random.default_rng(1), 3000)
    pieces = np.split(command, [1, 40, 40, 2000])

    def motions() -> list[Array]:
        response, theta = Response(plant, command[0]), Filter(plant.Gxtheta or plant.Gxx)
        both = [array for piece in pieces for array in response.motion(piece)]
        return [*both, *(theta.run(piece[:, 0]) for piece in pieces)]

    for one, other in zip(motions(), in_numpy(motions), strict=True):
        same(one, other)


@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize(("plants", "commands"), [(1, 1), (1, 3), (2, 2), (7, 1)])
def test_responses(
    paper: Printer, compiled: None, plants: int, commands: int, coupled: bool
) -> None:
    """Side by side, each nozzle moves as it does alone."""
    own = coupled_plant(1, racks=True) if coupled else paper.plant
    drawn = (own, *draws(own, 0.1, plants - 1, seed=1))
    origin = np.array([200.0, 80.0])
    each = [origin + walk(np.random.default_rng(k), 1000) for k in range(commands)]

    def motions() -> list[Array]:
        together = Plants(drawn).at_rest(origin, commands, 0.0)
        cuts = ([xy[cut] for xy in each] for cut in (slice(0, 1), slice(1, 400), slice(400, None)))
        return [together.run(pieces) for pieces in cuts]

    alone = [[Response(plant, origin).run(xy) for xy in each] for plant in drawn]
    for one, other in zip(motions(), in_numpy(motions), strict=True):
        same(one, other)
    same(np.concatenate(motions(), axis=2), np.array(alone))


@given(seeds, st.floats(3.5, 5.5))
@thorough
def test_clamp(paper: Printer, compiled: None, seed: int, power: float) -> None:
    """What needs no reduction passes at once, as it is."""
    rng = np.random.default_rng(seed)
    path = np.array([150.0, 100.0]) + 0.05 * walk(rng, 2000)
    off = np.zeros((2000, 2))
    off[rng.integers(0, 2000, 3)] = 10.0**power * TS**2 * rng.uniform(0.1, 1.0, (3, 2))
    xyze = np.column_stack([path, np.zeros((2000, 2))])
    whole = Samples(0, xyze, np.arange(2000), (), {"racking": path + off})

    def limited() -> tuple[Array, Clamped]:
        clamp = Clamp(paper.travel, paper.motors, paper.kinematics)
        chunks = [*clamp.limit(batches([whole], 777), "racking")]
        return np.concatenate([chunk.commands["racking"] for chunk in chunks]), clamp.clamped

    (one, clamped), (other, clamped_in_numpy) = limited(), in_numpy(limited)
    same(one, other)
    assert clamped == clamped_in_numpy


@thorough
@given(seeds, st.integers(1, 500), st.integers(0, 3), st.integers(0, 3))
def test_pieces(compiled: None, seed: int, n: int, strategies: int, coarser: int) -> None:
    """Straight pieces are joined; some change their line, layer or feature, or begin anew."""
    rng, picture = np.random.default_rng(seed), Picture(Labels())
    picture.coarser = coarser
    shape = np.zeros((WAYS + 2 * strategies, n), np.float32)
    shape[:Z], shape[WAYS:] = walk(rng, n).T, 0.002 * rng.normal(size=(2 * strategies, n))
    picture_module._numbers(shape)[:] = rng.random((4, n)) < rng.choice([0.0, 0.05, 0.5])
    same(picture._kept(shape), in_numpy(picture._kept, shape))


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


@thorough
@given(seeds, st.integers(1, 12), st.integers(0, 30), st.integers(1, 20))
def test_linear_algebra(compiled: None, seed: int, m: int, k: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(m, k)), rng.normal(size=(k, n)) * rng.choice([0.0, 1.0], size=n)
    same(product(A, B), in_numpy(product, A, B))
    x, apart = rng.normal(size=3 * m + k), int(rng.integers(1, 4))
    same(windows_product(x, apart, B), in_numpy(windows_product, x, apart, B))
    step, W = rng.normal(size=(n, n)) / n, rng.normal(size=(m, n))
    same(recursion(step, W, W[0]), in_numpy(recursion, step, W, W[0]))


@thorough
@given(seeds, st.integers(1, 200), st.floats(4.0, 8.0), st.booleans())
def test_lookahead(compiled: None, seed: int, n: int, power: float, rolls: bool) -> None:
    rng = np.random.default_rng(seed)
    steps = np.repeat(10.0 ** rng.uniform(-3.0, 1.5, (n, 4)), 3, axis=0)[:n]
    steps *= rng.choice([-1.0, 0.0, 1.0], (n, 4), p=[0.3, 0.2, 0.5])
    steps[:, X] += 1e-3 * (steps[:, :Z] == 0.0).all(axis=1)
    steps[:, Z] *= 0.01
    points = np.cumsum(np.vstack([np.zeros(4), steps]), axis=0)
    speed, asked, corner = np.repeat(rng.uniform(1.0, [[300.0], [3e3], [20.0]], (3, n)), 5, 1)[
        :, :n
    ]
    axes = FileLimits((20.0, np.inf, 20.0, 10.0), (np.inf, 500.0, 500.0, np.inf))
    axes = axes if rng.random() < 0.5 else FREE
    limits = replace(LIMITS, jerk=10.0**power, deceleration=10.0 ** rng.uniform(2.0, 4.0))
    limits = replace(limits, junction_deviation=0.1)
    moves = Moves(np.arange(n), points, speed.copy(), asked.copy(), corner.copy(), axes)

    def planned() -> list[NDArray[Any]]:
        limited = lookahead._limited(moves, limits)
        caps = lookahead._junction_speeds(limited, 1.0)
        runs = lookahead._runs(limited, caps, limits, float(caps[-1]) * rolls)
        return [limited.limits, caps, *runs]

    for one, other in zip(planned(), in_numpy(planned), strict=True):
        same(one, other)


@thorough
@given(seeds, st.integers(1, 30))
def test_profiles(compiled: None, seed: int, runs: int) -> None:
    rng = np.random.default_rng(seed)
    speed = rng.uniform(0.0, 200.0, runs + 1) * (rng.random(runs + 1) < 0.7)
    length = rng.exponential(5.0, runs) + np.abs(np.diff(np.square(speed))) / 1e3
    s = np.concatenate([[0.0], np.cumsum(length)])
    count, limits = np.arange(runs + 1), (np.full(runs, 250.0), np.full(runs, 2e3))
    plan = Plan(count[:-1], np.zeros((runs + 1, 4)), s, count, speed, *limits, ())

    def phases() -> tuple[Array, float]:
        [profile] = profiles.Profiler(5e6).profiles([plan])
        found, end = profiles.phases(plan, profile, 0.1234)
        return found.table, end

    (one, end), (other, plain_end) = phases(), in_numpy(phases)
    same(one, other)
    assert end == plain_end


@thorough
@given(seeds, st.integers(1, 30), st.floats(4.0, 9.0))
def test_ramps_between_speeds(compiled: None, seed: int, n: int, power: float) -> None:
    """Some begin or end at rest, some keep their speed, and some lengths are too short."""
    rng, jerk = np.random.default_rng(seed), 10.0**power
    v0, v1 = rng.uniform(0.0, 200.0, (2, n)) * (rng.random((2, n)) < 0.8)
    v1 = np.where(rng.random(n) < 0.2, v0, v1)
    length = 10.0 ** rng.uniform(-3.0, 2.0, n)

    def found() -> list[NDArray[Any]]:
        t, j, acceleration = profiles.ramps(v0, v1, length, jerk)
        return [t, j, acceleration, profiles._misses(t, j, v0, length)]

    for one, other in zip(found(), in_numpy(found), strict=True):
        same(one, other)


@thorough
@given(*[st.floats(0.01, 5.0)] * 2, *[st.floats(0.0, 30.0)] * 2, st.booleans())
def test_standing_moves(
    paper: Printer, compiled: None, z: float, e: float, entry: float, leaving: float, lifts: bool
) -> None:
    move = Standing(7, (1.0, 2.0, 0.3, 10.0), (1.0, 2.0, 0.3 + z * lifts, 10.0 - e), 40.0)
    profile = profiles.StandingProfile.from_move(move, paper.limits, entry, leaving)
    arguments = move, 1, profile.samples
    same(profile.places(*arguments), in_numpy(profile.places, *arguments))


def test_the_whole_tool(
    paper: Printer, library: ModuleType, monkeypatch: pytest.MonkeyPatch
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


def test_an_argument_of_another_kind_layout_or_length_is_an_error(library: ModuleType) -> None:
    s, points, room = np.arange(3.0), np.zeros((3, 4)), (np.empty((2, 4)), np.empty(2, np.int64))
    right = [s, points, 2, s[:2], 2, *room]
    frozen = room[0].copy()
    frozen.flags.writeable = False
    of_another_kind = {
        0: (s[::2], s.astype(np.float32), s.tolist(), 1.0, None, b"0"),
        2: (2.0, s),
        5: (frozen, room[1]),
    }
    of_another_length = {0: (s[:2],), 2: (0, -1, 1 << 40, 1 << 70, -(1 << 70)), 5: (room[0][:1],)}
    assert library.follow(*right) == 2
    for error, wrong in ((TypeError, of_another_kind), (ValueError, of_another_length)):
        for k, values in wrong.items():
            for value in values:
                with pytest.raises(error, match=f"argument {k} of follow"):
                    library.follow(*right[:k], value, *right[k + 1 :])
    for count in (0, len(right) - 1):
        with pytest.raises(TypeError, match="must be given"):
            library.follow(*right[:count])
    for more in (1, 100):
        with pytest.raises(TypeError, match="argument"):
            library.follow(*right, *[1] * more)


def test_another_thread_runs_during_a_loop(library: ModuleType) -> None:
    """Python itself would not switch threads for an hour."""
    n, before = 10_000, sys.getswitchinterval()
    arguments = np.arange(3.0), np.zeros((3, 4)), 2, np.zeros(n), n, np.empty((n, 4))
    moves, begin, ran = np.empty(n, np.int64), threading.Event(), threading.Event()

    def other() -> None:
        begin.wait()
        ran.set()

    thread = threading.Thread(target=other)
    sys.setswitchinterval(3600.0)
    try:
        thread.start()
        begin.set()
        for _ in range(10_000):
            library.follow(*arguments, moves)
            if ran.is_set():
                break
        assert ran.is_set()
    finally:
        sys.setswitchinterval(before)
        thread.join()


@pytest.mark.parametrize("name", ["missing", "another version"])
def test_numpy_is_used_where_the_module_is(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if name == "missing":
        monkeypatch.setitem(sys.modules, "hframe_post.native._kernels", None)
    else:
        monkeypatch.setattr(native, "BUILT_FOR", native.BUILT_FOR + 1)
    monkeypatch.setattr(native, "built", native.built.__wrapped__)
    assert native.kernel("follow") is None
