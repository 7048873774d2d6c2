"""Make streams of moves, plan them, and compute their limits one move at a time."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from hypothesis import strategies as st

from hframe_post.arrays import Array, E, Z
from hframe_post.planner import lookahead
from hframe_post.planner.lookahead import BATCH, LONGEST_QUEUE, Z_SHARE, plan
from hframe_post.printer.settings import Limits
from hframe_post.stream.marks import NO_MARKS, Mark, Marks
from hframe_post.stream.types import FileLimits, Item, ModalState, Moves, Plan
from tests.mark_tools import mark


def integrate(t: Array, j: Array, v0: Array) -> tuple[Array, Array, Array]:
    """Return acceleration and speed at the start of each phase, and its path length; all (r, 7)."""
    da = j * t
    a = _exclusive(np.cumsum(da, axis=1))
    v = v0[:, None] + _exclusive(np.cumsum(t * (a + da / 2.0), axis=1))
    return a, v, t * (v + t * (a / 2.0 + da / 6.0))


def _exclusive(cumulative: Array) -> Array:
    """Return cumulative sums along the rows as they are before each term."""
    shifted = np.zeros_like(cumulative)
    shifted[:, 1:] = cumulative[:, :-1]
    return shifted


INF = math.inf
FREE = FileLimits((INF, INF, INF, INF), (INF, INF, INF, INF))
LIMITS = Limits(
    velocity=300.0, acceleration=1e4, jerk=5e7, square_corner_velocity=5.0, z_velocity=20.0,
    z_acceleration=500.0, extruder_velocity=60.0, extruder_acceleration=2000.0,
)  # fmt: skip
STATE = ModalState(True, True, 0.0, 60.0, (0.0, 0.0, 0.0))


def moves(
    points: Iterable[Iterable[float]],
    speed: float | Array = 100.0,
    acceleration: float | Array = INF,
    corner: float = INF,
    limits: FileLimits = FREE,
    marks: Marks = NO_MARKS,
) -> Moves:
    at = np.array([list(point) for point in points], dtype=float)
    n = len(at) - 1
    column = np.ones(n)
    return Moves(
        np.arange(1, n + 1), at, speed * column, acceleration * column, corner * column,
        limits, marks,
    )  # fmt: skip


def cut(whole: Moves, size: int) -> list[Moves]:
    """The same moves in blocks of ``size``; a mark between two blocks goes with the later."""
    n, every = len(whole.line), list(whole.marks)
    blocks = []
    for a in range(0, n, size):
        b = min(a + size, n)
        marks = (m for m in every if a <= m.index < b or m.index == b == n)
        blocks.append(
            Moves(
                whole.line[a:b], whole.points[a : b + 1], whole.speed[a:b],
                whole.acceleration[a:b], whole.corner[a:b], whole.limits,
                Marks.from_lines(Mark(m.index - a, m.text) for m in marks),
            )
        )  # fmt: skip
    return blocks


def random_moves(seed: int, n: int, marked: float = 0.1) -> Moves:
    """Turns of all sizes, moves from micrometres to centimetres, some z, some retraction."""
    rng = np.random.default_rng(seed)
    turn = rng.normal(0.0, 10.0 ** rng.uniform(-3.0, 0.3, n))
    turn[rng.random(n) < 0.05] += math.pi
    length = 10.0 ** rng.uniform(-3.0, 1.5, n)
    heading = np.cumsum(turn)
    e = np.where(rng.random(n) < 0.7, 0.04, rng.choice([0.0, 0.03, -0.2], n)) * length
    z = np.where(rng.random(n) < 0.05, length * rng.normal(0.0, 0.5, n), 0.0)
    steps = np.stack([length * np.cos(heading), length * np.sin(heading), z, e], axis=1)
    points = np.concatenate([np.zeros((1, 4)), np.cumsum(steps, axis=0)])
    pieces = np.sort(rng.integers(0, n, 6))
    speed = np.repeat(rng.uniform(5.0, 400.0, 7), np.diff([0, *pieces, n]))
    asked = np.where(rng.random(n) < 0.9, INF, rng.uniform(300.0, 2e4, n))
    marks = (Mark(int(k), b"%d" % k) for k in np.flatnonzero(rng.random(n + 1) < marked))
    return moves(points, speed, asked, marks=Marks.from_lines(marks))


def gentle_spiral(n: int, radius: float = 30.0, step: float = 0.2, speed: float = 60.0) -> Moves:
    """A finely segmented vase in which no vertex limits anything."""
    angle = np.arange(n + 1) * step / radius
    s = step * np.arange(n + 1)
    columns = [radius * np.cos(angle), radius * np.sin(angle), 1e-4 * s, 0.04 * s]
    return moves(np.stack(columns, axis=1), speed)


def plans(
    items: Iterable[Item], limits: Limits = LIMITS, batch: int = BATCH, longest: int = LONGEST_QUEUE
) -> list[Plan]:
    return [item for item in plan(items, limits, batch, longest) if isinstance(item, Plan)]


def one(whole: Moves, limits: Limits = LIMITS) -> Plan:
    (only,) = plans([whole], limits)
    return only


def line(*steps: tuple[float, float, float, float]) -> Array:
    """Points from the origin on."""
    return np.concatenate([np.zeros((1, 4)), np.cumsum(np.array(steps), axis=0)])


jerks = st.floats(4.0, 9.0).map(lambda power: 10.0**power)


def klipper_cap(before: Array, after: Array, limits: list[tuple[float, float]]) -> float:
    """Greatest speed between two steps with (cruise, acceleration) each, after Klipper's text."""
    lengths = [float(np.linalg.norm(step[:E])) for step in (before, after)]
    cap2 = min(cruise for cruise, _ in limits) ** 2
    change = abs(after[E] / lengths[1] - before[E] / lengths[0])
    if change:
        cap2 = min(cap2, (LIMITS.extruder_corner_velocity / change) ** 2)
    cosine = -float(before[:E] @ after[:E]) / (lengths[0] * lengths[1])
    sine = math.sqrt(max(0.5 * (1.0 - cosine), 0.0))
    rest = math.sqrt(max(0.5 * (1.0 + cosine), 0.0))
    if sine < 1.0 and rest > 0.0:
        for length, (_, a) in zip(lengths, limits, strict=True):
            jd = LIMITS.square_corner_velocity**2 * (math.sqrt(2.0) - 1.0) / a
            cap2 = min(cap2, sine / (1.0 - sine) * jd * a, 0.5 * length * a * sine / rest)
    return math.sqrt(cap2)


def move_limits(step: Array, speed: float, asked: float) -> tuple[float, float]:
    length = float(np.linalg.norm(step[:E]))
    cruise, a = min(speed, LIMITS.velocity), min(asked, LIMITS.acceleration)
    if step[Z]:
        cruise = min(cruise, LIMITS.z_velocity * length / abs(step[Z]))
        a = min(a, Z_SHARE * LIMITS.z_acceleration * length / abs(step[Z]))
    if step[E] < 0.0:
        cruise = min(cruise, LIMITS.extruder_velocity * length / -step[E])
        a = min(a, Z_SHARE * LIMITS.extruder_acceleration * length / -step[E])
    elif step[E]:
        cruise = min(cruise, lookahead.MELTED * length / step[E])
    return cruise, a


def caps(whole: Moves) -> Array:
    """Greatest speed at each vertex, (n + 1,), one by one; the ends are free."""
    steps = np.diff(whole.points, axis=0)
    asked = zip(steps, whole.speed.tolist(), whole.acceleration.tolist(), strict=True)
    own = [move_limits(*row) for row in asked]
    inner = [klipper_cap(steps[k - 1], steps[k], own[k - 1 : k + 1]) for k in range(1, len(steps))]
    return np.array([INF, *inner, INF])


seeds = st.integers(0, 2**32 - 1)


def carried(text: bytes) -> Marks:
    return mark(0, text)
