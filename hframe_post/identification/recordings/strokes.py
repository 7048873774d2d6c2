"""The motion of `measure`: a minute of what prints are made of, around one place.

    rest, figures, rest, figures, …, back to the start, rest

Figures are strokes to and fro, zigzags of infill and paths with square corners, of random size,
direction, feed rate and acceleration. They are planned as a print is. A printer with friction or
play responds to a hum otherwise than to a stroke, so the best linear model of a print is that of a
motion like a print's. During the rests it rings out.

The random numbers are our own, so that equal settings give an equal motion with any library. They
begin with the place, so that the recording of one place does not follow the command of another.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, X, Y
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain
from hframe_post.errors import PrinterError
from hframe_post.identification.recordings.folder import STROKES
from hframe_post.identification.recordings.runs import (
    QUIET,
    PlannedRun,
    allowed,
    named,
    room,
    seconds_of,
)
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import frozen
from hframe_post.writers.print_time import duration

SECONDS = 60.0
LONGEST, SHORTEST = 80.0, 0.5  # mm of a stroke
INFILL = (0.4, 4.0)  # mm: length of its lines
LINE_WIDTH = 0.4  # mm between lines of infill
SIDES = (1.0, 25.0)  # mm between square corners
SLOWEST, GENTLEST = 0.2, 0.3  # of the limits: the lowest feed rate and acceleration
RAMP_HZ = 100.0  # jerk per acceleration: Klipper's host plays it within 20 µs, 1e7 mm/s³ within 80
MARGIN = 2.5  # times the strokes' acceleration, that the motors must allow Klipper
RESTS = (400.0, 700.0)  # samples between figures
AT_ONCE = 2.0  # s of figures without a rest
MASK = (1 << 64) - 1


def runs(
    printer: Printer, places: Sequence[tuple[float, float]] = (), seconds: float = SECONDS,
    name: str = STROKES,
) -> list[PlannedRun]:  # fmt: skip
    """Return the runs at places (x, y) in mm, by default in the middle; if it racks, three along x.

    name: how their names begin.

    A run moves both axes. Only where the bed moves, which has a sensor of its own, it moves one.
    Raises HframeError, and LimitError at a place without room.
    """
    if not printer.firmware.kind.records:
        raise PrinterError(
            f"{printer.firmware.dialect} records no accelerometers, which this run needs. To find "
            "out what drifted, measure again: 'hframe-post measure', then identify. To see what "
            "compensation brings, print a part with and without it (-c none)",
            "firmware.dialect", printer.name,
        )  # fmt: skip
    made = []
    for axes in [(X,), (Y,)] if printer.kinematics.bed_moves else [(X, Y)]:
        prefix = name if len(axes) > 1 else f"{name}-{'xy'[axes[0]]}"
        for own, at in named(prefix, printer, axes[0], places):
            made.append(PlannedRun(own, frozen(command(printer, at, axes, seconds))))
    return made


def command(
    printer: Printer, place: tuple[float, float], axes: Sequence[int] = (X, Y),
    seconds: float = SECONDS,
) -> Array:  # fmt: skip
    """Return the command (n, 2), mm every 1 ms, from rest at a place (mm) to rest there.

    axes: those that move. seconds: which it takes at least, and little longer. Raises LimitError if
    the place leaves no room.
    """
    printer = within_limits(printer)
    reach = np.zeros(2)
    for axis in axes:
        left = math.floor(1e3 * room(printer, axis, place)) / 1e3  # in the digits of the G-code
        reach[axis] = min(LONGEST / 2.0, left)
    x, y = (round(1e3 * p) for p in place)
    draw = _Draw(x + (y << 24) + (sum(axes) << 48))
    start = np.array(place)
    parts, at = [np.tile(start, (QUIET, 1))], np.zeros(2)
    while sum(map(len, parts)) < seconds / TS - QUIET:
        group = list(_group(draw, printer, axes, at, reach))
        parts.append(_sampled(printer, group, start))
        at = group[-1].vertices[-1]
        parts.append(np.tile(parts[-1][-1], (round(draw.between(*RESTS)), 1)))
    if at.any():
        limits = printer.limits
        home = _Figure(np.array([at, np.zeros(2)]), limits.velocity, limits.acceleration)
        parts.append(_sampled(printer, [home], start))
    return np.concatenate([*parts, np.tile(start, (QUIET, 1))])


def within_limits(printer: Printer) -> Printer:
    """Return the printer with the limits of the motion: those of a print that does not travel."""
    velocity, acceleration = allowed(printer, printer.kinematics.min_speed_ratio, MARGIN)
    gentle = replace(
        printer.limits, velocity=velocity, acceleration=acceleration,
        jerk=min(printer.limits.jerk, RAMP_HZ * acceleration),
    )  # fmt: skip
    return replace(printer, limits=gentle)


def summary(printer: Printer, planned: Sequence[PlannedRun]) -> str:
    """Return what the owner will see: the time in all, and how hard the strokes are."""
    limits = within_limits(printer).limits
    text = (
        f"{duration(seconds_of(planned))} in all, of strokes as in a print of up to "
        f"{limits.velocity:.0f} mm/s and {limits.acceleration:.0f} mm/s²"
    )
    if limits.acceleration < 0.999 * printer.limits.acceleration:  # rounding of [motors]
        text += (
            f"\nlimits.acceleration, {printer.limits.acceleration:g} mm/s², is more than [motors] "
            "or firmware.klipper.acceleration allow"
        )
    return text


# ---------------------------------------------------------------------- figures


@dataclass(frozen=True, slots=True)
class _Figure:
    """A path through vertices (k, 2), mm from the place, with its limits in mm/s and mm/s²."""

    vertices: Array
    velocity: float
    acceleration: float

    @property
    def seconds(self) -> float:
        """Return about how long it takes."""
        legs = np.hypot(*np.diff(self.vertices, axis=0).T)
        v, a = self.velocity, self.acceleration
        ramps = np.minimum(v / a, np.sqrt(legs / a))
        return float((np.maximum(legs / v, ramps) + ramps).sum())


class _Draw:
    """Random numbers by SplitMix64 (Steele, Lea, Flood, OOPSLA 2014)."""

    def __init__(self, seed: int) -> None:
        self._state = seed & MASK

    def between(self, low: float, high: float) -> float:
        self._state = (self._state + 0x9E3779B97F4A7C15) & MASK
        z = self._state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
        return low + (high - low) * ((z ^ (z >> 31)) >> 11) / (1 << 53)

    def log_between(self, low: float, high: float) -> float:
        # a logarithm differs in its last digit between C libraries
        return round(low * math.exp(self.between(0.0, math.log(high / low))), 3)

    def count(self, least: int, most: int) -> int:
        return least + int(self.between(0.0, most - least + 1))


def _group(
    draw: _Draw, printer: Printer, axes: Sequence[int], at: Array, reach: Array
) -> Iterator[_Figure]:
    """Yield figures for AT_ONCE seconds, each where the one before ends."""
    limits, seconds = printer.limits, 0.0
    while seconds < AT_ONCE:
        velocity = draw.log_between(SLOWEST * limits.velocity, limits.velocity)
        kind = (_strokes, _infill, _corners)[draw.count(0, 2 if len(axes) > 1 else 1)]
        turned = kind(draw, velocity) @ _directions(draw, axes)
        acceleration = round(limits.acceleration * draw.between(GENTLEST, 1.0))
        figure = _Figure(_inside(turned, at, reach), velocity, float(acceleration))
        if len(figure.vertices) > 1:
            yield figure
            seconds, at = seconds + figure.seconds, figure.vertices[-1]


def _strokes(draw: _Draw, velocity: float) -> Array:
    """Return a way to and fro along the first coordinate, (k, 2) mm, of a second each at most."""
    longest = max(min(LONGEST, velocity), 2.0 * SHORTEST)
    ways = [(-1.0) ** k * draw.log_between(SHORTEST, longest) for k in range(draw.count(2, 4))]
    along = np.concatenate([[0.0], np.cumsum(ways)])
    return np.column_stack([along, np.zeros(len(along))])


def _infill(draw: _Draw, _: float) -> Array:
    """Return a zigzag of short lines along the first coordinate, (k, 2) mm."""
    length, lines = draw.log_between(*INFILL), draw.count(8, 20)
    k = np.arange(2 * lines)
    return np.column_stack([length * ((k + 1) // 2 % 2), LINE_WIDTH * (k // 2)])


def _corners(draw: _Draw, velocity: float) -> Array:
    """Return a path with square corners, (k, 2) mm, with sides of half a second at most."""
    longest = max(min(SIDES[1], 0.5 * velocity), 2.0 * SIDES[0])
    points, heading = [np.zeros(2)], np.array([1.0, 0.0])
    for _ in range(draw.count(4, 10)):
        points.append(points[-1] + draw.log_between(SIDES[0], longest) * heading)
        turn = 1.0 if draw.between(0.0, 1.0) < 0.5 else -1.0
        heading = turn * np.array([-heading[1], heading[0]])
    return np.array(points)


def _directions(draw: _Draw, axes: Sequence[int]) -> Array:
    """Return where both coordinates of a figure point, (2, 2) in rows: an axis or a diagonal."""
    if len(axes) == 1:
        rows = np.zeros((2, 2))
        rows[0, axes[0]] = 1.0
        return rows
    s = math.sqrt(0.5)
    turns = ((1.0, 0.0), (0.0, 1.0), (s, s), (s, -s))
    cos, sin = turns[draw.count(0, len(turns) - 1)]
    return np.array([[cos, sin], [-sin, cos]])


def _inside(way: Array, at: Array, reach: Array) -> Array:
    """Return a way (k, 2) from a point (2,), mirrored and shortened so as to stay in ±reach."""
    way = way.copy()
    for axis in (X, Y):
        if at[axis] * (way[:, axis].min() + way[:, axis].max()) > 0.0:  # towards the nearer edge
            way[:, axis] *= -1.0
        lower, upper = -way[:, axis].min(), way[:, axis].max()
        rooms = (reach[axis] + at[axis], lower), (reach[axis] - at[axis], upper)
        way *= min([1.0, *(room / width for room, width in rooms if width > 0.0)])
    points = np.round(at + way, 3)
    moves = np.append(True, np.hypot(*np.diff(points, axis=0).T) > 0.0)
    return np.asarray(points[moves])


# ---------------------------------------------------------------------- planning


def _sampled(printer: Printer, figures: Sequence[_Figure], start: Array) -> Array:
    """Return the planned motion (n, 2) of figures around ``start``, mm every 1 ms."""
    lines = ["G28", "G90", "M83", _line(start + figures[0].vertices[0], printer.limits.velocity)]
    for figure in figures:
        lines.append(f"M204 S{figure.acceleration:g}")
        lines += [_line(start + vertex, figure.velocity) for vertex in figure.vertices[1:]]
    options = Options("none")
    chain = Chain(printer, options)
    chunks = chain.sampled(chain.planned(f"{line}\n".encode() for line in lines))
    return np.concatenate([chunk.xyze[:, :2] for chunk in chunks if len(chunk)])


def _line(to: Array, velocity: float) -> str:
    return f"G1 X{to[X]:.3f} Y{to[Y]:.3f} F{60.0 * velocity:.3f}"
