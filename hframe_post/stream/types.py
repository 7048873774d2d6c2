"""What flows from stage to stage. Lengths are mm, times s; one sample is TS.

Time is the integer index of a sample, never an accumulated float. A stage takes an
iterator of these and yields another; what it yields does not depend on how its input was
cut into pieces, and arrays are read-only once they have been yielded.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

from hframe_post.arrays import Array, Integers

Position = tuple[float, float, float, float]  # x, y, z, e


@dataclass(frozen=True, slots=True)
class Mark:
    """A line carried along without a stop, before the move or the sample ``index``."""

    index: int
    text: bytes


@dataclass(frozen=True, slots=True)
class FileLimits:
    """Axis limits that the file asked for (M201, M203): (x, y, z, e), mm/s and mm/s².

    travel: acceleration (mm/s²) that it asked for in travel alone (M204 T), whatever obeys it.
    """

    velocity: Position
    acceleration: Position
    travel: float = math.inf


@dataclass(frozen=True, slots=True)
class Moves:
    """n consecutive moves in which x or y travels, with the lines between them.

    line (n,): source lines. points (n + 1, 4): x, y, z, e from the start of the first move
    to the end of the last. speed, acceleration, corner (n,): path speed asked, and the
    file's acceleration and square-corner velocity (inf where it asks for none).
    """

    line: Integers
    points: Array
    speed: Array
    acceleration: Array
    corner: Array
    limits: FileLimits
    marks: tuple[Mark, ...] = ()


@dataclass(frozen=True, slots=True)
class Standing:
    """A move in which x and y stand still: retraction or lift. start, end: x, y, z, e."""

    line: int
    start: Position
    end: Position
    speed: float


@dataclass(frozen=True, slots=True)
class ModalState:
    """What the file believes of the firmware: modes, e (mm), feed (mm/s), G92 offsets (mm)."""

    absolute: bool
    absolute_e: bool
    e: float
    feed: float
    offset: tuple[float, float, float]


class Handling(Enum):
    """How a line that is not a planned move must reach the machine."""

    CARRY = "in mid-motion"
    REST = "at rest, inside the stream"
    RELEASE = "at rest, with the user's limits and modes in force"


@dataclass(frozen=True, slots=True)
class Passthrough:
    """A line that passes byte for byte.

    seconds: known duration. filament, path: mm that it extrudes and moves, as the file has it,
    where it is a move that starts at an unknown place; cause: the command that made it so.
    """

    line: int
    text: bytes
    handling: Handling
    state: ModalState
    seconds: float = 0.0
    filament: float = 0.0
    path: float = 0.0
    cause: str = ""


Item = Moves | Standing | Passthrough


@dataclass(frozen=True, slots=True)
class Plan:
    """Moves whose speeds are final.

    line (n,), points (n + 1, 4), s (n + 1,): path length at the vertices. ends (r + 1,):
    vertices where runs meet, speed (r + 1,) there. cruise, acceleration (r,): limits of each
    run. marks: index is a vertex.
    """

    line: Integers
    points: Array
    s: Array
    ends: Integers
    speed: Array
    cruise: Array
    acceleration: Array
    marks: tuple[Mark, ...]


@dataclass(frozen=True, slots=True)
class Halt:
    """The command comes to rest on the path here: what follows is computed on its own."""


Planned = Plan | Standing | Passthrough | Halt


def _no_line(_: bytes) -> bool:
    return False


@dataclass(frozen=True, slots=True)
class Rests:
    """Samples of standstill that the command gets before and after what happens at rest.

    aside: instead of both where it is ``long`` samples or longer, and at the ends of a stretch.
    corner: mm/s at which z passes from motion in x and y into a lift and the other way round, where
    none of these is needed; 0: it comes to rest there. labels: whether a carried line is one after
    which the machine must set out from rest. moving: mm/s², with which filament is retracted on the
    travel that follows, where there is time; 0: before it.
    """

    before: int = 0
    after: int = 0
    aside: int = 0
    long: int = 1 << 60
    corner: float = 0.0
    labels: Callable[[bytes], bool] = _no_line
    moving: float = 0.0


@dataclass(frozen=True, slots=True)
class Rest:
    """From sample ``index`` on the path stands for ``samples``; the command may move."""

    index: int
    samples: int


@dataclass(frozen=True, slots=True)
class Pause:
    """From sample ``index`` on the machine does ``action`` for ``samples``, x and y still.

    exact: duration (s) that the machine takes; samples·TS is the next millisecond. entry, leaving:
    speeds of z (mm/s) that are surely had where motion in x and y comes directly before and after.
    """

    index: int
    samples: int
    action: Standing | Passthrough
    exact: float = 0.0
    entry: float = 0.0
    leaving: float = 0.0


Event = Mark | Rest | Pause


@dataclass(frozen=True, slots=True)
class Samples:
    """Motion at samples first … first + n − 1.

    xyze (n, 4): the path, as desired. line (n,): source line of each. events: in order of
    their index, which lies in [first, first + n] (n: after the last sample). commands:
    strategy → (n, 2), the x and y for the motors; empty until ``compensate`` has run.
    ends_stretch: the machine is out of our hands after these, and may move itself.
    """

    first: int
    xyze: Array
    line: Integers
    events: tuple[Event, ...] = ()
    commands: dict[str, Array] = field(default_factory=dict)
    ends_stretch: bool = False

    def __len__(self) -> int:
        return len(self.xyze)

    @property
    def end(self) -> int:
        """Index of the sample after the last."""
        return self.first + len(self.xyze)


def frozen(array: Array) -> Array:
    """The array itself, made read-only."""
    array.flags.writeable = False
    return array
