"""What flows from stage to stage. Lengths are mm, times s; one sample is TS.

Time is the integer index of a sample, never an accumulated float. A stage takes an
iterator of these and yields another; what it yields does not depend on how its input was
cut into pieces, and arrays are read-only once they have been yielded.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from hframe_post.arrays import Array, Integers

TS = 1e-3  # s, the sampling time of the paper and of every profile
X, Y, Z, E = range(4)


Position = tuple[float, float, float, float]  # x, y, z, e


@dataclass(frozen=True, slots=True)
class Mark:
    """A line carried along without a stop, before the move or the sample ``index``."""

    index: int
    text: bytes


@dataclass(frozen=True, slots=True)
class FileLimits:
    """Axis limits that the file asked for (M201, M203): (x, y, z, e), mm/s and mm/s²."""

    velocity: Position
    acceleration: Position


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
    YIELD = "at rest, with the user's limits and modes in force"


@dataclass(frozen=True, slots=True)
class Passthrough:
    """A line that passes byte for byte. seconds: known duration; filament: mm it extrudes."""

    line: int
    text: bytes
    handling: Handling
    state: ModalState
    seconds: float = 0.0
    filament: float = 0.0


@dataclass(frozen=True, slots=True)
class Rest:
    """``samples`` of standstill from sample ``index`` in which the command may move.

    They let the command settle after motion (``settling``) or lead the motion that follows;
    ``settle`` cuts them to what is needed.
    """

    index: int
    samples: int
    settling: bool


@dataclass(frozen=True, slots=True)
class Pause:
    """From sample ``index`` on the machine does ``action`` for ``samples``, x and y still.

    exact: duration (s) that the machine takes; samples·TS is the next millisecond.
    """

    index: int
    samples: int
    action: Standing | Passthrough
    exact: float = 0.0


Event = Mark | Rest | Pause


@dataclass(frozen=True, slots=True)
class Samples:
    """Motion at samples first … first + n − 1.

    xyze (n, 4): the path, as desired. line (n,): source line of each. events: in order of
    their index, which lies in [first, first + n] (n: after the last sample). commands:
    strategy → (n, 2), the x and y for the motors; empty until ``compensate`` has run.
    """

    first: int
    xyze: Array
    line: Integers
    events: tuple[Event, ...] = ()
    commands: dict[str, Array] = field(default_factory=dict)

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


def shifted(event: Event, by: int) -> Event:
    """The event, ``by`` samples later."""
    if isinstance(event, Mark):
        return Mark(event.index + by, event.text)
    if isinstance(event, Rest):
        return Rest(event.index + by, event.samples, event.settling)
    return Pause(event.index + by, event.samples, event.action, event.exact)


def recut(blocks: Iterable[Samples], size: int) -> Iterator[Samples]:
    """The same samples and events in pieces of ``size``; only the last may be shorter."""
    held: list[Samples] = []
    count = 0
    for block in blocks:
        held.append(block)
        count += len(block)
        while count > size:  # one sample stays, so that events after the last keep their block
            joined = join(held)
            yield part(joined, 0, size)
            held = [part(joined, size, count)]
            count -= size
    if held:
        yield join(held)


def join(blocks: list[Samples]) -> Samples:
    """Contiguous blocks as one."""
    if len(blocks) == 1:
        return blocks[0]
    return Samples(
        blocks[0].first,
        frozen(np.concatenate([b.xyze for b in blocks])),
        np.concatenate([b.line for b in blocks]),
        tuple(event for b in blocks for event in b.events),
        {
            name: frozen(np.concatenate([b.commands[name] for b in blocks]))
            for name in blocks[0].commands
        },
    )


def part(block: Samples, start: int, stop: int) -> Samples:
    """Samples start … stop − 1 of a block; the events of ``stop`` only if the block ends there."""
    low, high = block.first + start, block.first + stop
    events = tuple(
        e for e in block.events if low <= e.index and (e.index < high or high >= block.end)
    )
    commands = {name: xy[start:stop] for name, xy in block.commands.items()}
    return Samples(low, block.xyze[start:stop], block.line[start:stop], events, commands)
