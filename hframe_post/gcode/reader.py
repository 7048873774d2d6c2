"""Reads G-code: text → moves, moves in which x and y stand, and lines that pass through.

Rules:
 1. A line that is not motion passes byte for byte and in order.
 2. A line that would be misread as motion is an error, never a guess.
 3. After a line whose motion cannot be known (homing, a macro, a tool change) the position
    is unknown, and the next move goes to the firmware as it stands.
 4. Lines that only set limits or the feed-rate factor are obeyed here and do not pass:
    inside a dense stream the firmware would obey them a second time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from hframe_post.errors import GcodeError
from hframe_post.gcode import arcs, commands
from hframe_post.gcode.commands import Dialect, Words
from hframe_post.gcode.coordinates import AXES, Coordinates, Word
from hframe_post.gcode.gathering import Gathering
from hframe_post.gcode.lexer import (
    PLAIN_MOVE,
    Command,
    Line,
    command,
    numbers,
    parameters,
    uncommented,
)
from hframe_post.gcode.limits import RequestedLimits
from hframe_post.stream.types import Handling, Item, Passthrough, Position, Standing

MOVES_PER_ITEM = 4096
FARTHEST = 1e6  # mm; a coordinate beyond is a corrupted number
DEFAULT_FEED = 25.0  # mm/s, what Klipper moves at before the first F


def read(lines: Iterable[bytes], dialect: Dialect, file_limits: bool = True) -> Iterator[Item]:
    """Items of a G-code file, streaming.

    lines: with or without line ends. dialect: of the firmware for which the file was sliced.
    file_limits: whether M201, M203, M204, M205 and SET_VELOCITY_LIMIT are obeyed. Raises
    GcodeError.
    """
    reader = _Reader(dialect, file_limits)
    out = reader.items.out
    number = 0
    for number, raw in enumerate(lines, 1):
        text = raw.removesuffix(b"\n")
        line = Line(number, _first_line(text) if number == 1 else text)
        match = PLAIN_MOVE.match(line.text)
        if match is None:
            reader.line(line)
        else:
            reader.plain_move(line, match.groups())
        if out:
            yield from out
            out.clear()
    reader.finish(number)
    yield from out


def _first_line(text: bytes) -> bytes:
    if text.startswith(b"GCDE"):
        raise GcodeError(
            "this is binary G-code; in PrusaSlicer or OrcaSlicer turn off "
            "'Supports binary G-code' in the printer's settings and slice again"
        )
    return text.removeprefix(b"\xef\xbb\xbf")


class _Reader:
    """Takes line after line; what it has read is in ``items``."""

    def __init__(self, dialect: Dialect, file_limits: bool) -> None:
        self._dialect, self._file_limits = dialect, file_limits
        self._place = Coordinates(dialect)
        self._limits = RequestedLimits(dialect)
        self._feed, self._factor = DEFAULT_FEED, 1.0
        self._moved = False
        self.items = Gathering(self._limits)

    # ------------------------------------------------------------------ moves

    def plain_move(self, line: Line, words: tuple[bytes | None, ...]) -> None:
        """G0 or G1 with its words in the usual order: the hot path."""
        _, f, x, y, z, e, f_last = words
        try:
            if f or f_last:
                self._set_feed(line, float(f or f_last or 0))
            if x or y or z or e:
                self._move(
                    line,
                    float(x) if x else None,
                    float(y) if y else None,
                    float(z) if z else None,
                    float(e) if e else None,
                )
        except ValueError:
            raise line.error("a number cannot be read") from None

    def _move(self, line: Line, x: Word, y: Word, z: Word, e: Word) -> None:
        """One straight move to the file's coordinates."""
        place = self._place
        old, new = place.position, place.target(x, y, z, e)
        self._moved = True
        if not (min(new) > -FARTHEST and max(new) < FARTHEST):
            raise line.error("a coordinate is out of all bounds")
        if not place.allow(z):
            if place.scale != 1.0:  # the output is in mm
                raise line.error("a move in inches from an unknown position")
            self._passthrough(line, Handling.RELEASE, filament=new[3] - old[3])
            place.arrive(new, x, y, z)
        elif new[0] != old[0] or new[1] != old[1]:
            self._travel(line, new)
        elif new != old:
            top = self._limits.axes.velocity[2 if new[2] != old[2] else 3]
            self.items.stand(Standing(line.number, old, new, min(self._feed * self._factor, top)))
            place.position = new

    def _travel(self, line: Line, new: Position) -> None:
        """A move in which x or y travels joins the gathered ones."""
        self.items.travel(line.number, self._place.position, new, self._feed * self._factor)
        self._place.position = new
        if len(self.items) >= MOVES_PER_ITEM:
            self.items.flush()

    def _set_feed(self, line: Line, feed: float) -> None:
        if not 0.0 < feed < math.inf:
            raise line.error("the feed rate must be positive")
        self._feed = feed * self._place.scale / 60.0

    def _arc(self, line: Line, words: Words, ccw: bool) -> None:
        place = self._place
        if not place.xy_plane:
            raise line.error("arcs outside the x-y plane are not supported")
        if not place.allow(words.get("Z")):
            raise line.error("an arc from an unknown position")
        x0, y0, z0, e0 = place.position
        x1, y1, z1, e1 = place.target(*(words.get(axis) for axis in AXES))
        offset = None
        if "I" in words or "J" in words:
            offset = (words.get("I", 0.0) * place.scale, words.get("J", 0.0) * place.scale)
        radius = words["R"] * place.scale if "R" in words else None
        centre = arcs.centre((x0, y0), (x1, y1), offset, radius, ccw)
        if centre is None:
            raise line.error("the arc's centre or radius does not fit its ends")
        points = arcs.chords((x0, y0), (x1, y1), centre, ccw)
        lengths = np.hypot(*np.diff(points, axis=0, prepend=[(x0, y0)]).T)
        share = np.cumsum(lengths) / lengths.sum()
        z, e = z0 + share * (z1 - z0), e0 + share * (e1 - e0)
        z[-1], e[-1] = z1, e1
        self._moved = True
        for row in np.column_stack([points, z, e]).tolist():
            self._travel(line, tuple(row))

    # ------------------------------------------------------------------ all other lines

    def line(self, line: Line) -> None:
        """A line that is not a plain move."""
        coded = command(line)
        if coded is None:
            self._uncoded(line)
        elif coded.name in commands.MOTION_WORDS:
            self._motion(line, coded)
        elif coded.name in commands.MISREAD:
            raise line.error(f"{coded.name}: {commands.MISREAD[coded.name]}")
        elif coded.name in commands.LIMIT_WORDS:
            words = numbers(line, coded.arguments, commands.LIMIT_WORDS[coded.name])
            self._limit(line, coded.name, words)
        elif coded.name in commands.MODAL:
            self._place.set_mode(coded.name)
            if coded.name != "G20":  # the output is in mm, and Klipper has no inches
                self._passthrough(line, Handling.CARRY)
        else:
            self._other(line, coded)

    def _motion(self, line: Line, coded: Command) -> None:
        """G0, G1, G2, G3 and G92, written in any way."""
        words = numbers(line, coded.arguments, commands.MOTION_WORDS[coded.name])
        if "F" in words:
            self._set_feed(line, words.pop("F"))
        if coded.name == "G92":
            if not self._place.redefine(words):
                raise line.error("G92 names known and unknown positions at once")
            # that of E alone is harmless in the stream, whose E is relative
            only_e = words.keys() == {"E"}
            self._passthrough(line, Handling.CARRY if only_e else Handling.RELEASE)
        elif coded.name in ("G2", "G3"):
            self._arc(line, words, ccw=coded.name == "G3")
        elif words:
            self._move(line, *(words.get(axis) for axis in AXES))

    def _limit(self, line: Line, name: str, words: Words) -> None:
        """M201, M203, M204, M205, M220 or SET_VELOCITY_LIMIT."""
        for letter, value in words.items():
            if value < 0.0 or (value == 0.0 and not commands.may_be_zero(name, letter)):
                raise line.error(f"{letter} must be positive")
        if name == "M220":
            self._factor = words.get("S", 100.0 * self._factor) / 100.0
        elif self._file_limits:
            if name in ("M201", "M203") or "VELOCITY" in words:
                self.items.flush()  # axis limits hold for all moves of an item
            self._limits.take(name, words)

    def _uncoded(self, line: Line) -> None:
        """A comment, a Klipper macro or anything that is not G, M or T."""
        if line.text.startswith(commands.STAMP):
            raise line.error("this file has been through hframe-post already")
        if b"\0" in line.text:
            raise GcodeError("this is not a text file", line.number)
        words = uncommented(line.text).split()
        if not words or words == [b"%"]:
            self._passthrough(line, Handling.CARRY)
            return
        name = words[0].upper()
        if name == b"SET_VELOCITY_LIMIT":
            self._limit(line, "SET_VELOCITY_LIMIT", parameters(line))
            return
        handling = commands.macro_handling(name)
        self._passthrough(line, handling)
        if handling is Handling.RELEASE:
            self._place.forget()

    def _other(self, line: Line, coded: Command) -> None:
        """A coded command that is neither motion, mode nor limit."""
        handling = commands.command_handling(*coded)
        seconds = 0.0
        if coded.name == "G4":
            seconds = self._dialect.dwell(numbers(line, coded.arguments, "PS"))
        self._passthrough(line, handling, seconds)
        if coded.name == "G28":
            named = [axis for axis in range(3) if AXES[axis].encode() in coded.arguments.upper()]
            self._place.forget(named or range(3), homed=True)
        elif handling is Handling.RELEASE:
            self._place.forget()

    def _passthrough(
        self, line: Line, handling: Handling, seconds: float = 0.0, filament: float = 0.0
    ) -> None:
        """A line that passes as it stands, with what the file believes of the firmware."""
        state = self._place.state(self._feed)
        item = Passthrough(line.number, line.text, handling, state, seconds, filament)
        self.items.pass_through(item)

    def finish(self, number: int) -> None:
        """The end of the file: what is gathered, and the modes to leave behind."""
        if not number:
            raise GcodeError("the file is empty")
        if not self._moved:
            raise GcodeError("there is not a single move in this file", number)
        self._passthrough(Line(number, b""), Handling.RELEASE)
