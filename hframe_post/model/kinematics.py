"""Kinematics: motion at constant acceleration, and x, y ↔ the two motors that move the nozzle.

============= ======= ======= ==================================== ===============================
type          A       B       racks                                Klipper, Marlin
============= ======= ======= ==================================== ===============================
hbot          x + y   x − y   yes: one belt pulls the gantry askew ``corexy``, COREXY
corexy        x + y   x − y   no: two belts, crossed               ``corexy``, COREXY
hybrid-corexy x − y   y       no                                   ``hybrid_corexy``, MARKFORGED_XY
corexz        x       y       no: x and z share belts              ``corexz``, COREXZ
cartesian     x       y       no                                   ``cartesian``, neither
============= ======= ======= ==================================== ===============================

A is the motor of ``stepper_x`` (X_STEP), B that of ``stepper_y`` (Y_STEP). ``swap`` exchanges A
and B (an H-bot whose motors are at the other end of y); then ``signs`` reverse them. On a CoreXZ,
A is x + z, which in the plane is x; its third motor, x − z, moves with x, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from hframe_post.arrays import TS, Array


# not frozen: a print has tens of thousands, which take a third of the time to make so
@dataclass(slots=True)
class Trapezoid:
    """A motion: length (mm), limits of speed and acceleration; v_s, v_e: speeds at its ends.

    peak: its greatest speed; seconds: how long it takes.
    """

    length: float
    cruise: float
    acceleration: float
    v_s: float = 0.0
    v_e: float = 0.0
    peak: float = field(init=False)
    seconds: float = field(init=False)

    def __post_init__(self) -> None:
        v_s, v_e, a = self.v_s, self.v_e, self.acceleration
        reached = math.sqrt(self.length * a + (v_s * v_s + v_e * v_e) / 2.0)
        peak = reached if reached < self.cruise else self.cruise
        ramped = ((peak - v_s) ** 2 + (peak - v_e) ** 2) / (2.0 * a)
        self.peak, self.seconds = peak, (self.length + ramped) / peak

    @property
    def ramps(self) -> tuple[float, float]:
        """Return how long it accelerates and brakes, s."""
        peak = self.peak
        return (peak - self.v_s) / self.acceleration, (peak - self.v_e) / self.acceleration

    @property
    def row(self) -> Array:
        """Return length, v_s, acceleration, peak, both ramps' and all of the seconds, (7,)."""
        way = self.length, self.v_s, self.acceleration, self.peak, *self.ramps, self.seconds
        return np.array(way)

    def slowed_to(self, seconds: float) -> Trapezoid:
        """Return the same motion at the lower speed at which it takes so long, or itself if longer.

        Solves length = v·T − [(v − v_s)² + (v − v_e)²]/2a for v no lower than v_s and v_e.
        """
        if seconds <= self.seconds:
            return self
        S = self.acceleration * seconds + self.v_s + self.v_e
        c = (self.v_s * self.v_s + self.v_e * self.v_e) / 2.0 + self.acceleration * self.length
        v = (S - math.sqrt(max(S * S - 4.0 * c, 0.0))) / 2.0
        cruise = min(max(v, self.v_s, self.v_e), self.cruise)
        return Trapezoid(self.length, cruise, self.acceleration, self.v_s, self.v_e)

    def distance(self, t: Array) -> Array:
        """Return the distance done (n,), mm, at times t (n,), s, after its beginning."""
        up, down = self.ramps
        t = np.clip(t, 0.0, self.seconds)
        begun, ending = np.minimum(t, up), np.maximum(t - (self.seconds - down), 0.0)
        lost = self.acceleration * ending * ending / 2.0
        gained = begun * (self.v_s + self.acceleration * begun / 2.0)
        return np.asarray(gained + self.peak * (t - begun) - lost)


@dataclass(frozen=True, slots=True)
class Belts:
    """What a type of kinematics is: rows of motors A and B, mm of belt per mm in x and y.

    racks: whether a force in x can twist the gantry. bed_moves: in y, with what is printed on it.
    z_is_separate: whether the motors of z move nothing in x.
    """

    rows: tuple[tuple[float, float], tuple[float, float]]
    racks: bool = False
    bed_moves: bool = False
    z_is_separate: bool = True


TYPES = {
    "hbot": Belts(((1.0, 1.0), (1.0, -1.0)), racks=True),
    "corexy": Belts(((1.0, 1.0), (1.0, -1.0))),
    "hybrid-corexy": Belts(((1.0, -1.0), (0.0, 1.0))),
    "corexz": Belts(((1.0, 0.0), (0.0, 1.0)), bed_moves=True, z_is_separate=False),
    "cartesian": Belts(((1.0, 0.0), (0.0, 1.0)), bed_moves=True),
}


@dataclass(frozen=True, slots=True)
class Kinematics:
    """Relation of belts and nozzle; mm of belt per mm of nozzle."""

    type: str = field(default="hbot", metadata={"choices": TYPES})
    swap: bool = False
    signs: tuple[float, float] = field(default=(1.0, 1.0), metadata={"choices": (-1.0, 1.0)})

    @property
    def racks(self) -> bool:
        """Return whether a force in x can twist the gantry."""
        return TYPES[self.type].racks

    @property
    def bed_moves(self) -> bool:
        """Return whether the bed moves in y, with what is printed on it."""
        return TYPES[self.type].bed_moves

    @property
    def z_is_separate(self) -> bool:
        return TYPES[self.type].z_is_separate

    @property
    def matrix(self) -> Array:
        """Return the matrix (2, 2) from x, y to the belts: rows A and B."""
        rows = TYPES[self.type].rows[:: -1 if self.swap else 1]
        return np.array(
            [[sign * x, sign * y] for sign, (x, y) in zip(self.signs, rows, strict=True)]
        )

    def belts(self, x: Array, y: Array) -> Array:
        """Return belt positions A, B, (2, n), at nozzle positions x, y (n,), mm."""
        (ax, ay), (bx, by) = self.matrix.tolist()
        return np.stack([ax * x + ay * y, bx * x + by * y])

    @property
    def max_speed_ratio(self) -> float:
        """Return the speed of the nozzle in its fastest direction, for belts at speed 1."""
        corners = np.array([[1.0, 1.0], [1.0, -1.0]])  # both belts at once; others mirror these
        return float(np.linalg.norm(np.linalg.solve(self.matrix, corners), axis=0).max())

    @property
    def min_speed_ratio(self) -> float:
        """Return the speed of the nozzle in its slowest direction, for belts at speed 1."""
        return float(1.0 / np.linalg.norm(self.matrix, axis=1).max())


@dataclass(frozen=True, slots=True)
class Rates:
    """Speeds and accelerations of belts A, B and of x, y, (2, n) each; mm/s and mm/s²."""

    belt_velocity: Array
    belt_acceleration: Array
    axis_acceleration: Array


class Differences:
    """Rates of a command that comes in pieces, by backward differences.

    Before its first sample the command is taken to be at rest.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics = kinematics
        self._before: Array | None = None

    def before(self, command: Array) -> Array:
        """Return the two samples before the next ones, (2, 2), which are the command (n, 2)."""
        if self._before is None:
            self._before = command[:1].repeat(2, axis=0)
        return self._before

    def pass_by(self, command: Array) -> None:
        """Take the next samples of the command (n, 2), mm."""
        if len(command):
            self._before = np.concatenate([self.before(command), command[-2:]])[-2:]

    def rates(self, command: Array) -> Rates:
        """Return the rates at the next samples of the command (n, 2), mm, before they pass by."""
        if not len(command):
            nothing = np.zeros((2, 0))
            return Rates(nothing, nothing, nothing)
        known = np.concatenate([self.before(command), command])
        belts, step, change = self._kinematics.belts, np.diff(known.T)[:, 1:], np.diff(known.T, n=2)
        return Rates(belts(*step) / TS, belts(*change) / TS**2, change / TS**2)
