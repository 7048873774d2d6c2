"""Klipper's motion: how it makes moves of the stream and moves at rest."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers, Z
from hframe_post.firmware.code import plain
from hframe_post.firmware.klipper.klipper_code import StreamLimits
from hframe_post.firmware.motion import USED_LINES_SHARE, MotionRules, NextTo, Stroke, Way
from hframe_post.model.constant_acceleration import Trapezoid
from hframe_post.native.decimate import breakpoints, fitted, too_thick
from hframe_post.native.ramps import klipper_durations, klipper_feeds
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.stream.types import StopRules

MAX_LIFT_STRETCH = 1.1  # times a lift's own duration, to which it may be slowed down


@dataclass(frozen=True, slots=True)
class KlipperMotion(MotionRules):
    """Klipper's motion.

    tolerance: mm by which the decimated command may miss a sample; None keeps every sample.
    users_corner: the user's square corner velocity, mm/s.
    """

    table: KlipperTable
    limits: StreamLimits
    tolerance: float | None = None
    users_corner: float = 0.0

    @property
    def lines_per_second(self) -> float:
        return self.table.lines_per_second

    @property
    def stop_rules(self) -> StopRules:
        """Return how lifts and retractions pass into motion.

        A lift passes no faster than a square corner of the user's, and comes to rest where every
        sample is written.
        """
        corner = self.limits.lift_corner
        passes = self.tolerance is not None and corner <= self.users_corner
        return StopRules(lift_speed=corner if passes else 0.0)

    def segments(self, points: Array, forced: Flags, last: bool) -> tuple[Integers, Array]:
        if self.tolerance is None:
            return np.arange(1, len(points)), points[1:]
        ends = breakpoints(points, forced, self.tolerance)
        if self.lines_per_second < math.inf:
            ends = sparser(
                points, forced, self.tolerance, ends, USED_LINES_SHARE * self.lines_per_second
            )
        ends = thinned(points, ends)
        return ends, fitted(points, ends)

    def feeds(
        self, at: Array, T: Array, rest: Flags, before: float, after: float, per_feed: float
    ) -> tuple[Integers, Array]:
        return klipper_feeds(at, T, rest, before, after, self.limits.row, per_feed)

    def durations(
        self, at: Array, v: Array, rest: Flags, before: float, after: float = math.inf
    ) -> Array:
        return klipper_durations(at, v, rest, before, after, self.limits.row)

    def corners(
        self, way: Way, speed: float, planned: tuple[float, float], previous: Way | None = None
    ) -> tuple[float, float]:
        """Return the speeds in the corners of a lift that the plan joins to motion."""
        if planned == (0.0, 0.0):
            return planned
        lift = abs(way.end[Z] - way.start[Z])
        # a short lift needs the other half of its way to brake
        fits = math.sqrt(lift * self.limits.z_acceleration / 2.0)
        corner = min(self.limits.lift_corner, fits, speed, self.limits.z_velocity)
        into, out = planned
        return (corner if into else 0.0, corner if out else 0.0)

    def stroke(
        self, way: Way, speed: float, seconds: float, wanted: float,
        entry: float = 0.0, leaving: float = 0.0,
    ) -> Stroke:  # fmt: skip
        """Return the user's speed; a lift from or into motion is slowed down to be in time."""
        start, end, _ = way
        lifted = abs(end[Z] - start[Z])
        if lifted and end[E] == start[E]:
            cruise, a = min(speed, self.limits.z_velocity), self.limits.z_acceleration
            lift = Trapezoid(lifted, cruise, a, entry, leaving)
            seconds = lift.seconds
            if entry or leaving:
                lift = lift.slowed_to(min(wanted, MAX_LIFT_STRETCH * seconds))
                speed, seconds = lift.cruise, lift.seconds
        return Stroke(speed, seconds, leaving)

    def dwell(self, seconds: float, next_to: NextTo) -> tuple[bytes, float] | None:
        """Return G4, next to a lift even for no time.

        Without it Klipper would round the corner between lift and motion, and be early.
        """
        if next_to is not NextTo.LIFT and seconds < TS / 2.0:
            return None
        waited = max(round(seconds, 6), 0.0)
        return b"G4 P%s\n" % plain(waited * 1e3, 3).encode(), waited


# ----------------------------------------------------------------------
# Segments for Klipper: few of them, and none that it would refuse.

PIECE_SAMPLES = 250  # samples, within which the bound on lines is kept
TOLERANCE_GROWTH = 1.2  # times the tolerance, until a second has few enough segments


def thinned(points: Array, ends: Integers) -> Integers:
    """Return ends (k,), and more, so that Klipper refuses no segment as too thick an extrusion.

    Next to a stop the command may crawl where the path does not. Klipper allows a cross section
    of 4 nozzle widths squared (``max_extrude_cross_section``), and more than that in pieces with no
    more filament than such a line as long as the nozzle is wide.
    """
    thick, most = too_thick(points, ends)
    if not len(thick):
        return ends
    pieces = [ends]
    for k in thick.tolist():  # few
        first, end = int(ends[k - 1]) if k else 0, int(ends[k])
        piece = np.floor((points[first:end, E] - points[first, E]) / most[0])
        pieces.append(first + 1 + np.flatnonzero(np.diff(piece[1:])))
    return np.unique(np.concatenate(pieces))


def sparser(
    points: Array, forced: Flags, tolerance: float, ends: Integers, rate: float
) -> Integers:
    """Return the breakpoints ``ends``, fewer wherever a second has more than ``rate`` of them.

    points, forced, tolerance: as for ``breakpoints``. In such a second the tolerance grows.
    """
    fewer = []
    for first in range(0, len(points) - 1, PIECE_SAMPLES):
        last = min(first + PIECE_SAMPLES, len(points) - 1)
        kept, allowed = ends[(ends > first) & (ends <= last)], rate * (last - first) * TS
        allowed = max(allowed, 1.0 + np.count_nonzero(forced[first + 1 : last]))
        coarse = tolerance
        while len(kept) > allowed:
            coarse *= TOLERANCE_GROWTH
            kept = first + breakpoints(points[first : last + 1], forced[first : last + 1], coarse)
        if coarse > tolerance and first:
            fewer.append(np.array([first]))
        fewer.append(kept)
    return np.unique(np.concatenate(fewer))
