"""The greatest speeds at which firmware passes the junction of two moves.

They are those of Klipper's ``toolhead`` (docs/Kinematics.md, "Look-ahead"), after Grbl's junction
deviation: the corner is passed as if on an arc that is tangent to both moves and misses their
vertex by the junction deviation. With θ the angle between the moves (180° is straight on),
R = sin(θ/2)/(1 − sin(θ/2)):

    v² ≤ R·deviation·a                  centripetal acceleration on the arc
    v² ≤ ½·length·a·tan(θ/2)            the arc must fit into half of each move
    v ≤ corner velocity / |Δ(e per mm)| sudden change of extrusion speed

A square corner (θ = 90°) is passed at v_sc where deviation = (√2 − 1)·v_sc²/a. In C this is a part
of the loops of ``lookahead.c`` and ``ramps.c``.
"""

from __future__ import annotations

import math

import numpy as np

from hframe_post.arrays import Array, E

# cosine of the turns with which an arc must fit into short moves: Marlin takes √½, with which
# rounding decides at the 45° of infill
GENTLE = 0.71


def junction_deviation(square_corner_velocity: Array | float, acceleration: Array | float) -> Array:
    """Return the junction deviation, mm, for a speed through a right angle; same shapes."""
    squared = np.square(square_corner_velocity)
    return np.asarray((math.sqrt(2.0) - 1.0) * squared / acceleration)


def square_corner_velocity(deviation: float, acceleration: float) -> float:
    """Return the speed through a right angle, mm/s, for a junction deviation in mm."""
    return math.sqrt(deviation * acceleration / (math.sqrt(2.0) - 1.0))


def junction_speeds(
    delta: Array,
    length: Array,
    acceleration: Array,
    deviations: Array | float,
    extruder_corner_velocity: float,
    shorter: float = math.inf,
) -> Array:
    """Return the greatest speed (n − 1,) between n consecutive moves, mm/s.

    delta (n, 4): x, y, z, e of each; length (n,): mm of path in x, y, z; acceleration (n,);
    deviations (n,) or one for all. Of two neighbours, the lower deviation·acceleration counts.
    shorter: arcs must fit into moves that are shorter, mm. If it is finite, as in Marlin, they must
    where the path turns by less than 45° only.
    """
    # not delta / length: in a reversal, 1 − cosθ consists of rounding, which must be Klipper's
    unit = delta[:, :E] * (1.0 / length)[:, None]
    x, y, z = (unit[:-1] * unit[1:]).T
    cosine = np.clip(-(x + y + z), -1.0, 1.0)
    sin_half, cos_half = np.sqrt(0.5 * (1.0 - cosine)), np.sqrt(0.5 * (1.0 + cosine))
    turn, fit = deviations * acceleration, 0.5 * length * acceleration
    with np.errstate(divide="ignore", invalid="ignore"):
        v2 = np.minimum(turn[:-1], turn[1:]) * sin_half / (1.0 - sin_half)
        arc = np.minimum(fit[:-1], fit[1:]) * sin_half / cos_half
        if math.isfinite(shorter):
            short = (cosine <= -GENTLE) & (np.minimum(length[:-1], length[1:]) < shorter)
            arc = np.where(short, arc, math.inf)
        v2 = np.fmin(v2, arc)
        extruder = extruder_corner_velocity / np.abs(np.diff(delta[:, E] / length))
    return np.asarray(np.fmin(np.sqrt(v2), extruder))
