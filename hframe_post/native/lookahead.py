"""Look-ahead over a queue of moves, in C and in numpy: limits, junctions, and speeds of runs.

Moves are a table (n, 4): length, cruise speed, acceleration and junction deviation of each. See
``planner.lookahead`` for the rules.
"""

from __future__ import annotations

import math

import numpy as np

from hframe_post.arrays import Array, E, Flags, Integers, Z, lengths
from hframe_post.native import kernel
from hframe_post.native.corners import junction_deviation, junction_speeds

PLATEAU = 256  # moves at cruise speed in a run
# Shares of acceleration and jerk, and of the cruise speed at vertices, that keep Ruckig off the
# edge of what is feasible
FEASIBLE, BELOW_CRUISE = 1.0 - 1e-6, 1.0 - 1e-4
STEEP = 1.0  # rise over run above which a move starts and ends at rest
CREEP = 0.01  # mm/s; a junction that allows less is a stop

Runs = tuple[Array, Integers, Array]


def limit_moves(
    points: Array, speed: Array, acceleration: Array, corner: Array, rules: Array
) -> Array:
    """Return the table (n, 4) of moves between points (n + 1, 4) with limits.

    speed, acceleration, corner (n,): what the file asks for. rules (23,): cruise speed,
    that of travels, acceleration, that of travels, speed in z, of retractions, of melted filament,
    acceleration in z, of filament, speed through a square corner, junction deviation; then speed
    and acceleration of motors A and B, z and e, and the matrix from x, y to A and B.
    """
    table = np.empty((len(speed), 4))
    if (compiled := kernel("limit_moves")) is not None:
        compiled(points, speed, acceleration, corner, len(table), rules, table)
    else:
        table.T[:] = _least_limits(points, speed, acceleration, corner, *rules.tolist())
    return table


def _least_limits(
    points: Array, speed: Array, acceleration: Array, square_corner: Array, velocity: float,
    fastest: float, accelerate: float, hardest: float, z_velocity: float, retract: float,
    melted: float, z_acceleration: float, e_acceleration: float, corner: float, deviation: float,
    *of_file: float,
) -> tuple[Array, ...]:  # fmt: skip
    delta = np.diff(points, axis=0)
    length = lengths(delta[:, :E])
    belts = np.reshape(of_file[8:], (2, 2))
    # of each motor, z and e in a millimetre of path
    share = np.abs(np.column_stack([delta[:, :Z] @ belts.T, delta[:, Z:]])) / length[:, None]
    travels = delta[:, E] == 0.0
    cruise = np.minimum(speed, np.where(travels, fastest, velocity))
    acceleration = np.minimum(acceleration, np.where(travels, hardest, accelerate))
    retracting = np.where(delta[:, E] < 0.0, share[:, E], 0.0)
    extruding = share[:, E] - retracting
    with np.errstate(divide="ignore"):
        for axis, asked in enumerate(of_file[:4]):
            if math.isfinite(asked):
                cruise = np.minimum(cruise, asked / share[:, axis])
        for axis, asked in enumerate(of_file[4:8]):
            if math.isfinite(asked):
                acceleration = np.minimum(acceleration, asked / share[:, axis])
        cruise = np.minimum(cruise, z_velocity / share[:, Z])
        cruise = np.minimum(cruise, retract / retracting)
        cruise = np.minimum(cruise, melted / extruding)
        by_z, by_e = z_acceleration / share[:, Z], e_acceleration / retracting
    deviations = junction_deviation(np.minimum(square_corner, corner), acceleration)
    acceleration = np.minimum(acceleration, np.minimum(by_z, by_e))
    return length, cruise, acceleration, np.minimum(deviations, deviation)


def greatest_speeds(
    points: Array, moves: Array, extruder_corner_velocity: float, shorter: float = math.inf,
    steep: float = STEEP,
) -> Array:  # fmt: skip
    """Return the greatest speed at each vertex, (n + 1,), without limits at the ends.

    shorter: see ``junction_speeds``. steep: rise over run above which a move is made from rest.
    """
    if (compiled := kernel("junctions")) is not None:
        caps = np.empty(len(points))
        constants = extruder_corner_velocity, shorter, BELOW_CRUISE, steep, CREEP
        compiled(points, moves, len(moves), *constants, caps)
        return caps
    delta = np.diff(points, axis=0)
    length, cruise, acceleration, deviation = moves.T
    inner = junction_speeds(
        delta, length, acceleration, deviation, extruder_corner_velocity, shorter
    )
    dx, dy, dz, _ = np.square(delta).T
    with np.errstate(invalid="ignore"):  # infinite times 0
        upright = dz > steep * steep * (dx + dy)
    inner[upright[:-1] | upright[1:] | (inner < CREEP)] = 0.0
    cruise = BELOW_CRUISE * cruise
    inner = np.minimum(inner, np.minimum(cruise[:-1], cruise[1:]))
    return np.concatenate([cruise[:1], inner, cruise[-1:]])


def find_runs(moves: Array, caps: Array, jerk: float, deceleration: float, last: float) -> Runs:
    """Return the path length at each vertex, which vertices end runs, and the speeds there.

    caps (n + 1,): greatest speeds at the vertices; last: speed at the last vertex, mm/s.
    """
    n = len(moves)
    if (compiled := kernel("find_runs")) is not None:
        (s, speed), ends = np.empty((2, n + 1)), np.empty(n + 1, np.int64)
        constants = FEASIBLE * jerk, deceleration, last, FEASIBLE, PLATEAU
        r = compiled(moves, caps, n, *constants, np.empty(8 * (n + 1)), s, ends, speed)
        return s, ends[: r + 1], speed[: r + 1]
    length, cruise, acceleration, _ = moves.T
    caps2 = np.square(caps)
    caps2[-1] = last * last
    a = FEASIBLE * acceleration
    b = FEASIBLE * np.minimum(acceleration, deceleration)
    s, reach2, stop2 = _summed(length), _summed(2.0 * a * length), _summed(2.0 * b * length)
    braking = np.minimum.accumulate((caps2 + stop2)[::-1])[::-1] - stop2
    v2 = np.minimum.accumulate(np.minimum(braking, caps2) - reach2) + reach2
    v2 = np.clip(v2, 0.0, caps2)
    v2[0] = caps2[0]
    rounding = 1e-15 * reach2[-1]  # of v2, whatever its size
    reached = v2 >= (1.0 - 1e-6) * caps2 - rounding
    ends = np.flatnonzero(_limiting(cruise, acceleration, caps, reached))
    speed, run, jerk = np.sqrt(v2[ends]), np.diff(s[ends]), FEASIBLE * jerk
    _lower(speed, run, b[ends[:-1]], jerk, from_end=True)
    speed[0] = caps[0]  # final before, with the share of FEASIBLE to spare
    _lower(speed, run, a[ends[:-1]], jerk, from_end=False)
    return s, ends, speed


def _summed(terms: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(terms)])


def _limiting(cruise: Array, a: Array, caps: Array, reached: Flags) -> Flags:
    """Return at which vertices a run must end; ``reached``: where the cap is reached.

    At cruise speed every PLATEAU-th vertex ends a run, so that a long way becomes final in parts.
    """
    limiting = np.ones(len(caps), dtype=bool)
    slowed = caps[1:-1] < (1.0 - 2e-4) * np.minimum(cruise[:-1], cruise[1:])
    slowed[PLATEAU - 1 :: PLATEAU] = True
    change = (cruise[:-1] != cruise[1:]) | (a[:-1] != a[1:])
    limiting[1:-1] = (slowed & reached[1:-1]) | change
    return limiting


def _lower(speed: Array, length: Array, acceleration: Array, jerk: float, from_end: bool) -> None:
    """Lower speeds to what can be reached along the whole chain from its start, or its end."""
    if from_end:
        speed, length, acceleration = speed[::-1], length[::-1], acceleration[::-1]
    active = np.arange(len(length))
    while len(active):
        top = reachable_speed(speed[active], length[active], acceleration[active], jerk)
        lower = top < speed[active + 1]
        active, top = active[lower] + 1, top[lower]
        speed[active] = top
        active = active[active < len(length)]


def reachable_speed(v0: Array, length: Array, acceleration: Array, jerk: float) -> Array:
    """Return the greatest speed reached from ``v0`` within ``length``, all (n,), mm and s.

    It starts and ends at zero acceleration. Accelerating by Δ takes T = Δ/a + a/j, or 2√(Δ/j)
    where Δ < a²/j, over (v0 + Δ/2)·T.
    """
    a, j = acceleration, jerk
    # full acceleration: Δ²/2a + Δ(v0/a + a/2j) + v0·a/j − length = 0
    b = v0 / a + a / (2.0 * j)
    c = length - v0 * a / j
    full = a * (np.sqrt(np.maximum(b * b + 2.0 * c / a, 0.0)) - b)
    # never at full acceleration: u³ + 2·v0·u − length·√j = 0 with u = √Δ
    q = length * math.sqrt(j)
    p = np.maximum(2.0 * v0, 1e-12)
    fourth = np.sqrt(np.sqrt(q))
    sixteenth = np.sqrt(np.sqrt(fourth))
    u = np.minimum(fourth * sixteenth * np.sqrt(np.sqrt(sixteenth)), q / p)  # within a half
    for _ in range(5):  # Newton's steps to the last digit, since libraries' cube roots differ
        u = (2.0 * u * u * u + q) / (3.0 * u * u + p)
    return v0 + np.where(full >= a * a / j, full, np.minimum(u * u, a * a / j))
