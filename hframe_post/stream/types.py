"""The types that flow from stage to stage. Lengths are in mm, times in s; one sample is TS.

Time is the integer index of a sample, never an accumulated float. A stage takes an iterator
of these and yields another. What it yields does not depend on how its input was cut into
pieces, and arrays are read-only once they have been yielded.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.native.planning import lower_moves
from hframe_post.stream.marks import NO_MARKS, Mark, Marks

Position = tuple[float, float, float, float]  # x, y, z, e


@dataclass(frozen=True, slots=True)
class FileLimits:
    """Limits that hold next to each move's own: the firmware's, until the file sets others; mm, s.

    velocity, acceleration: of the motors A and B, of z and e (M203, M201). belts: from x, y to A
    and B. path: speed along the path (VELOCITY). deviation: of junctions (M205 J). cruise_ratio: of
    a move that brakes as soon as it has accelerated, the share that must be at constant speed.
    retract: acceleration of filament where nothing else moves (M204 R); inf: the firmware has none.
    """

    velocity: Position = (math.inf,) * 4
    acceleration: Position = (math.inf,) * 4
    retract: float = math.inf
    path: float = math.inf
    deviation: float = math.inf
    cruise_ratio: float = 0.0
    belts: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.0), (0.0, 1.0))

    def at_rest(
        self, start: Position, end: Position, speed: float, acceleration: float
    ) -> tuple[float, float]:
        """Lower speed and acceleration of a move while x and y rest; see ``MoveAtRest``.

        A firmware with an acceleration for filament alone has its own for z, too.
        """
        dz, de = abs(end[2] - start[2]), abs(end[3] - start[3])
        shares = [(axis, d / (dz or de)) for axis, d in ((2, dz), (3, de)) if d]
        speed = min([speed, *(self.velocity[axis] / share for axis, share in shares)])
        if self.retract == math.inf or not dz:
            return speed, self.retract
        limits = (self.acceleration[axis] / share for axis, share in shares)
        return speed, min(acceleration, *limits)

    def lower(self, speed: Array, acceleration: Array, points: Array) -> int:
        """Lower speed and acceleration (n,) of moves between points (n + 1, 4) to these limits.

        Returns how many moves became slower.
        """
        (ax, ay), (bx, by) = self.belts
        limits = np.array([*self.velocity, *self.acceleration, ax, ay, bx, by, self.path])
        return lower_moves(points, limits, speed, acceleration)


@dataclass(frozen=True, slots=True)
class Moves:
    """n consecutive moves in which x or y changes, with the lines between them.

    line (n,): source lines. points (n + 1, 4): x, y, z, e from the start of the first move
    to the end of the last. speed, acceleration, corner (n,): requested path speed, acceleration
    and square-corner velocity (inf where the file requests none).
    """

    line: Integers
    points: Array
    speed: Array
    acceleration: Array
    corner: Array
    limits: FileLimits
    marks: Marks = NO_MARKS


@dataclass(frozen=True, slots=True)
class MoveAtRest:
    """A move made while x and y are at rest: a retraction or a lift. start, end: x, y, z, e.

    speed, acceleration: of z, or of the filament if z rests too; inf: the profile's. entry,
    leaving: speeds at its ends, once planned, where firmware passes them without a stop.
    """

    line: int
    start: Position
    end: Position
    speed: float
    acceleration: float = math.inf
    entry: float = 0.0
    leaving: float = 0.0

    def __reduce__(self) -> tuple[type[MoveAtRest], tuple[Any, ...]]:
        """Pickle the fields alone: a print has thousands of these."""
        own = self.line, self.start, self.end, self.speed, self.acceleration
        return MoveAtRest, (*own, self.entry, self.leaving)


@dataclass(frozen=True, slots=True)
class ModalState:
    """The firmware's state as the file assumes it: modes, e (mm), feed (mm/s), G92 offsets (mm).

    advance, smooth_time: s of pressure advance, and of its averaging, that the file has set; None:
    it has set none. acceleration: of travel, mm/s², as the firmware has it at this place.
    """

    absolute: bool
    absolute_e: bool
    e: float
    feed: float
    offset: tuple[float, float, float]
    advance: float | None = None
    smooth_time: float | None = None
    acceleration: float = math.inf


class Handling(Enum):
    """How a line that is not a planned move must reach the machine. CARRY: as one of ``Marks``."""

    CARRY = "during motion"
    REST = "at rest, inside the stream"
    RELEASE = "at rest, with the user's limits and modes in force"


@dataclass(frozen=True, slots=True)
class Passthrough:
    """A pass-through line, which reaches the output byte for byte.

    seconds: known duration. For a move from an unknown position, filament and path are what it
    extrudes and moves (mm), and cause is the command that made the position unknown. end: where a
    move ends (mm) whose beginning was known.
    """

    line: int
    text: bytes
    handling: Handling
    state: ModalState
    seconds: float = 0.0
    filament: float = 0.0
    path: float = 0.0
    cause: str = ""
    end: Position | None = None


Standing = tuple[int, MoveAtRest | Marks]
Item = Moves | MoveAtRest | Passthrough | Marks


@dataclass(frozen=True, slots=True)
class Plan:
    """Moves whose speeds are final.

    line (n,), points (n + 1, 4), s (n + 1,): path length at the vertices. ends (r + 1,):
    vertices between runs, speed (r + 1,) there. cruise, acceleration (r,): limits of each
    run. marks: index is a vertex. rests: x and y rest at the end, from whatever speed there.
    standing: lifts and retractions that are among the moves, and lines after them, each with the
    move that it is, or that follows; s begins again at 0 where the machine rests in one of them.
    """

    line: Integers
    points: Array
    s: Array
    ends: Integers
    speed: Array
    cruise: Array
    acceleration: Array
    marks: Marks
    rests: bool = False
    standing: tuple[Standing, ...] = ()


@dataclass(frozen=True, slots=True)
class SpanEnd:
    """A place where the command comes to rest on the path: what follows is computed separately."""


Planned = Plan | MoveAtRest | Passthrough | Marks | SpanEnd


@dataclass(frozen=True, slots=True)
class StopRules:
    """Rules for stops: how many samples of rest the path gets, and where it needs none.

    before, after: samples of rest around a dwell. long_rest: samples instead of both where it
    takes ``long_from`` samples or longer, and at the ends of a stretch.
    lift_speed: mm/s of z between a lift and motion in x and y that directly precedes or follows it,
    if neither needs samples of rest; 0: z comes to rest there.
    joined: firmware passes into lifts and retractions at a speed, so that x and y stop there as in
    a corner, and short rests bring nothing.
    """

    before: int = 0
    after: int = 0
    long_rest: int = 0
    long_from: int = 1 << 60
    lift_speed: float = 0.0
    joined: bool = False


@dataclass(frozen=True, slots=True)
class Rest:
    """Rest of the path for ``samples`` from ``index`` on; the command may move."""

    index: int
    samples: int


@dataclass(frozen=True, slots=True)
class Dwell:
    """``samples`` from ``index`` on in which the command dwells and the machine does ``action``.

    exact: duration (s) that the machine takes; samples·TS is the next millisecond. entry, leaving:
    speeds of z (mm/s) that are certain where motion in x and y directly precedes and follows.
    """

    index: int
    samples: int
    action: MoveAtRest | Passthrough
    exact: float = 0.0
    entry: float = 0.0
    leaving: float = 0.0


@dataclass(frozen=True, slots=True)
class SlowStraight:
    """Slow straight motion whose ``samples``, from ``index`` on, are left out.

    The stretch ends at ``index``. end: x, y, z, e at the last of the samples.
    """

    index: int
    samples: int
    end: Position


Event = Marks | Rest | Dwell | SlowStraight


@dataclass(frozen=True, slots=True)
class Samples:
    """Motion at samples first … first + n − 1.

    xyze (n, 4): the desired path. line (n,): source line of each. events: in order of their
    index, which is in [first, first + n] (first + n: after the last sample). commands:
    strategy → (n, 2), x and y for the motors; empty until ``compensate`` has run.
    ends_stretch: the machine may move on its own after these samples, or a ``SlowStraight`` or a
    long ``Dwell`` leaves out samples between these and the next. advance (n, 2): mm by which the
    extruder is ahead of e, and the s of pressure advance for which it is; None: both are
    0. in_e: what is written for E must contain that; otherwise the firmware adds it.
    """

    first: int
    xyze: Array
    line: Integers
    events: tuple[Event, ...] = ()
    commands: dict[str, Array] = field(default_factory=dict)
    ends_stretch: bool = False
    advance: Array | None = None
    in_e: bool = False

    def __len__(self) -> int:
        return len(self.xyze)

    @property
    def end(self) -> int:
        return self.first + len(self.xyze)


def said(item: Item | Event, kind: int) -> Iterator[Mark]:
    """Yield the lines that pass in an item, of many in motion those that may be of a kind."""
    if isinstance(item, Marks):
        yield from item.of(kind)
    elif isinstance(item, Passthrough):
        yield Mark(0, item.text)
    elif isinstance(item, Dwell) and isinstance(item.action, Passthrough):
        yield Mark(item.index, item.action.text)


def frozen(array: Array) -> Array:
    """Return the array itself, made read-only."""
    array.flags.writeable = False
    return array
