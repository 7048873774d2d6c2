"""A G-code file as motion in nominal time, cut where a line is anything but a move.

Nominal time is length over feed rate: a firmware's ramps are left out, alike in all files. Inside
a stream they are not alike, since they depend on how it was cut into segments, and its feed
rates have them in mind; so there they count, with the limits that the stream itself sets.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from hframe_post.arrays import Array, E, Integers, Z, lengths
from hframe_post.firmware import ramps
from hframe_post.gcode import arcs
from hframe_post.gcode.commands import (
    LIMIT_PARAMETERS,
    LIMITS,
    MODAL,
    MOTION_WORDS,
    STAMP,
    Dialect,
    Words,
)
from hframe_post.gcode.coordinates import AXES, Coordinates
from hframe_post.gcode.feed import DEFAULT_FEED
from hframe_post.gcode.lexer import (
    PLAIN_MOVE,
    Command,
    Line,
    command,
    numbers,
    parameters,
    plain_words,
)
from hframe_post.gcode.motion import MOST_TURNS
from hframe_post.model import cornering
from hframe_post.stream.types import Position, frozen

EXTRUDER_CORNER_VELOCITY = 1.0  # mm/s, by default; no file tells it
COLUMNS = 6  # of a vertex: source line, nominal time, x, y, z, e


@dataclass(frozen=True, slots=True)
class Section:
    """n moves that follow each other, and the line that ends them.

    line (n,): source lines. time (n + 1,): from the section's start, s, ascending. xyze
    (n + 1, 4): places, mm; e is all filament since the start of the file. closing: the line
    after them, None at the end of the file.
    """

    line: Integers
    time: Array
    xyze: Array
    closing: Line | None


def sections(lines: Iterable[bytes], dialect: Dialect) -> Iterator[Section]:
    """The file in sections, streaming. Raises GcodeError.

    A dwell (G4) is motion too, that stays where it is: its length depends on how motion was cut.
    What a move's own comment says is left out, and so is the stamp of this tool.
    """
    reader = _Reader(dialect, Coordinates(dialect))
    for number, raw in enumerate(lines, 1):
        line = Line(number, raw.removeprefix(b"\xef\xbb\xbf").rstrip())
        plain = PLAIN_MOVE.match(line.text)
        if plain is not None:
            reader.plain_move(line, plain.groups())
        elif not (line.text.startswith(STAMP) or reader.moves(line)):
            yield reader.section(line)
    yield reader.section(None)


@dataclass
class _Reader:
    """Follows the file; vertices since the last section are in rows of COLUMNS numbers."""

    dialect: Dialect
    place: Coordinates
    feed: float = DEFAULT_FEED
    limits: Words = field(default_factory=dict)  # those of SET_VELOCITY_LIMIT so far
    rows: array[float] = field(default_factory=lambda: array("d"))

    def __post_init__(self) -> None:
        self.place.known = (True, True, True)  # what both files make of a homed machine is alike
        self._begin()

    def plain_move(self, line: Line, groups: tuple[bytes | None, ...]) -> None:
        """G0 or G1 with its words in the usual order."""
        f, *places = plain_words(line, groups)
        if f is not None:
            self._set_feed(line, f)
        self._go(line, self.place.target(*places))

    def moves(self, line: Line) -> bool:
        """Whether any other line is a move; what it means is taken in."""
        coded = command(line)
        if coded is None:
            return False
        if coded.name in MOTION_WORDS:
            return self._motion(line, coded)
        if coded.name == "G4":
            seconds = self.dialect.dwell(numbers(line, coded.arguments, "PS"))
            self._spend(line, self.place.position, seconds)
            return True
        if coded.name in MODAL:
            self.place.set_mode(coded.name)
        elif coded.name == "G28":
            named = [axis for axis in range(3) if AXES[axis].encode() in coded.arguments.upper()]
            self.place.forget(named or range(3), homed=True)
            self.place.known = (True, True, True)
        return False

    def _motion(self, line: Line, coded: Command) -> bool:
        words = numbers(line, coded.arguments, MOTION_WORDS[coded.name])
        if "F" in words:
            self._set_feed(line, words.pop("F"))
        if coded.name == "G92":
            self.place.redefine(words)
            return False
        end = self.place.target(*(words.get(axis) for axis in AXES))
        if coded.name not in ("G0", "G1"):
            return self._curve(line, words, end, coded.name)
        self._go(line, end)
        return True

    def _curve(self, line: Line, words: Words, end: Position, name: str) -> bool:
        """G2, G3 or G5; one that does not fit the place it starts from is a line like others."""
        place = self.place
        start, scale = place.position, place.scale
        i, j, p, q = (words.get(letter, 0.0) * scale for letter in "IJPQ")
        if name == "G5":
            first, second = (start[0] + i, start[1] + j), (end[0] + p, end[1] + q)
            points, share = arcs.spline(start[:2], first, second, end[:2])
        else:
            ccw, centre = name == "G3", (start[0] + i, start[1] + j)
            ends = start[:2], end[:2]
            by_radius = "R" in words and not {"I", "J"} & words.keys()
            found = arcs.centre_of_radius(*ends, words["R"] * scale, ccw) if by_radius else centre
            turns = int(min(max(words.get("P", 1.0), 1.0), MOST_TURNS))
            arc = arcs.arc(*ends, found, ccw, turns) if found else None
            if arc is None or not place.xy_plane:
                place.position = end
                return False
            points, share = arc.chords()
        z, e = (start[k] + share * (end[k] - start[k]) for k in (2, 3))
        for x, y, z_k, e_k in np.column_stack([points, z, e]).tolist():
            self._go(line, (x, y, z_k, e_k))
        return True

    def _set_feed(self, line: Line, feed: float) -> None:
        if not 0.0 < feed < math.inf:
            raise line.error("the feed rate must be positive")
        self.feed = feed * self.place.scale / 60.0

    def _go(self, line: Line, end: Position) -> None:
        start = self.place.position
        length = math.dist(start[:3], end[:3]) or abs(end[3] - start[3])
        if not length < math.inf:
            raise line.error("a coordinate is out of all bounds")
        self._spend(line, end, length / self.feed)

    def _spend(self, line: Line, end: Position, seconds: float) -> None:
        if seconds > 0.0:
            self._time += seconds
            self.rows.extend((line.number, self._time, *end))
            self.place.position = end

    def _begin(self) -> None:
        self._time = 0.0
        self.rows = array("d", (0.0, 0.0, *self.place.position))

    def section(self, closing: Line | None) -> Section:
        """What has been gathered, ended by this line."""
        table = np.array(self.rows).reshape(-1, COLUMNS)
        time, places = table[:, 1].copy(), frozen(table[:, 2:].copy())
        if self._in_stream and len(time) > 1:
            time[1:] = np.cumsum(self._with_ramps(np.diff(places, axis=0), np.diff(time)))
        if closing is not None and closing.text.upper().startswith(LIMITS.encode()):
            self.limits |= parameters(closing, LIMIT_PARAMETERS)
        self._begin()
        return Section(table[1:, 0].astype(np.int64), frozen(time), places, closing)

    @property
    def _in_stream(self) -> bool:
        """A slicer asks for no cruise ratio of 0, a stream always does."""
        known = {"ACCEL", "SQUARE_CORNER_VELOCITY"} <= self.limits.keys()
        return known and self.limits.get("MINIMUM_CRUISE_RATIO") == 0.0

    def _with_ramps(self, delta: Array, nominal: Array) -> Array:
        """Time (n,) that moves delta (n, 4) take instead of the nominal, s.

        A line that cuts motion need not stop it; where it does, the moves beside it are slow.
        """
        a = np.full(len(delta), self.limits["ACCEL"])
        d = lengths(delta[:, :E])
        moves = (delta[:, :Z] != 0.0).any(axis=1)
        d = np.where(moves, d, 1.0)  # mm, of anything
        deviation = cornering.junction_deviation(self.limits["SQUARE_CORNER_VELOCITY"], a[0])
        inner = cornering.junction_speeds(delta, d, a, deviation, EXTRUDER_CORNER_VELOCITY)
        inside = np.where(moves[1:] & moves[:-1], inner, 0.0)
        caps = np.concatenate([[math.inf], inside, [math.inf]])
        taken = ramps.durations(d, d / nominal, a, caps, math.inf)
        return np.where(moves, taken, nominal)
