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
from hframe_post.gcode.lexer import PLAIN_MOVE, command, numbers, parameters, uncommented
from hframe_post.gcode.limits import Asked
from hframe_post.stream.types import (
    Handling,
    Item,
    Mark,
    ModalState,
    Moves,
    Passthrough,
    Position,
    Standing,
    frozen,
)

MOVES_PER_BLOCK = 4096
FARTHEST = 1e6  # mm; a coordinate beyond is a corrupted number
INCH = 25.4
DEFAULT_FEED = 25.0  # mm/s, what Klipper moves at before the first F


def read(lines: Iterable[bytes], firmware: str, file_limits: bool = True) -> Iterator[Item]:
    """Items of a G-code file, streaming.

    lines: with or without line ends. firmware: ``klipper`` or ``marlin``, which differ in
    what G90 does to E and in what M204 means. file_limits: whether M201, M203, M204, M205
    and SET_VELOCITY_LIMIT are obeyed. Raises GcodeError.
    """
    reader = _Reader(firmware, file_limits)
    number = 0
    for number, raw in enumerate(lines, 1):
        text = raw.removesuffix(b"\n")
        if number == 1:
            text = _first_line(text)
        match = PLAIN_MOVE.match(text)
        if match is None:
            reader.line(number, text)
        else:
            reader.plain_move(number, text, match.groups())
        if reader.out:
            yield from reader.out
            reader.out.clear()
    reader.finish(number)
    yield from reader.out


def _first_line(text: bytes) -> bytes:
    if text.startswith(b"GCDE"):
        raise GcodeError(
            "this is binary G-code; in PrusaSlicer or OrcaSlicer turn off "
            "'Supports binary G-code' in the printer's settings and slice again"
        )
    return text.removeprefix(b"\xef\xbb\xbf")


class _Reader:
    """Modal state, the moves gathered since the last item, and items ready in ``out``."""

    def __init__(self, firmware: str, file_limits: bool) -> None:
        self.firmware, self.file_limits = firmware, file_limits
        self.absolute, self.absolute_e, self.scale = True, True, 1.0
        self.feed, self.factor = DEFAULT_FEED, 1.0
        self.position: Position = (0.0, 0.0, 0.0, 0.0)  # e counts on through every G92
        self.offset = [0.0, 0.0, 0.0, 0.0]  # the file's coordinate + offset = position
        self.known = [False, False, False]
        self.asked = Asked(firmware)
        self.xy_plane = True
        self.start: Position = self.position
        self.rows: list[tuple[float, ...]] = []
        self.marks: list[Mark] = []
        self.out: list[Item] = []
        self.moved = False

    # ------------------------------------------------------------------ moves

    def plain_move(self, number: int, text: bytes, words: tuple[bytes | None, ...]) -> None:
        """G0 or G1 with its words in the usual order: the hot path."""
        _, f, x, y, z, e, f_last = words
        try:
            if f or f_last:
                self._set_feed(float(f or f_last or 0), number, text)
            if x or y or z or e:
                self._move(
                    number,
                    text,
                    float(x) if x else None,
                    float(y) if y else None,
                    float(z) if z else None,
                    float(e) if e else None,
                )
        except ValueError:
            raise GcodeError("a number cannot be read", number, text) from None

    def _move(
        self,
        number: int,
        text: bytes,
        x: float | None,
        y: float | None,
        z: float | None,
        e: float | None,
    ) -> None:
        """One straight move to the file's coordinates."""
        old, new = self.position, self._target(x, y, z, e)
        self.moved = True
        if not (min(new) > -FARTHEST and max(new) < FARTHEST):
            raise GcodeError("a coordinate is out of all bounds", number, text)
        if not (self.known[0] and self.known[1] and (self.known[2] or z is None)):
            if self.scale != 1.0:  # the output is in mm
                raise GcodeError("a move in inches from an unknown position", number, text)
            self._passthrough(number, text, Handling.YIELD, filament=new[3] - old[3])
            self.position = new
            if self.absolute:
                self.known = [
                    known or word is not None
                    for known, word in zip(self.known, (x, y, z), strict=True)
                ]
        elif new[0] != old[0] or new[1] != old[1]:
            self._travel(number, new)
        elif new != old:
            self._flush()
            top = self.asked.limits.velocity[2 if new[2] != old[2] else 3]
            self.out.append(Standing(number, old, new, min(self.feed * self.factor, top)))
            self.position = new

    def _travel(self, number: int, new: Position) -> None:
        """A move in which x or y travels joins the gathered ones."""
        if not self.rows:
            self.start = self.position
        self.rows.append(
            (number, *new, self.feed * self.factor, self.asked.acceleration, self.asked.corner)
        )
        self.position = new
        if len(self.rows) >= MOVES_PER_BLOCK:
            self._flush()

    def _target(
        self, x: float | None, y: float | None, z: float | None, e: float | None
    ) -> Position:
        """Where a move's words lead, counted as ``position`` is."""
        px, py, pz, pe = self.position
        ox, oy, oz, oe = self.offset if self.absolute else self.position
        if not self.absolute_e:
            oe = pe
        elif self.firmware == "marlin":  # where G91 cleared absolute_e, and M82 may set it
            oe = self.offset[3]
        scale = self.scale
        return (
            px if x is None else ox + x * scale,
            py if y is None else oy + y * scale,
            pz if z is None else oz + z * scale,
            pe if e is None else oe + e * scale,
        )

    def _set_feed(self, feed: float, number: int, text: bytes) -> None:
        if not 0.0 < feed < math.inf:
            raise GcodeError("the feed rate must be positive", number, text)
        self.feed = feed * self.scale / 60.0

    def _arc(self, number: int, text: bytes, words: dict[str, float], ccw: bool) -> None:
        if not self.xy_plane:
            raise GcodeError("arcs outside the x-y plane are not supported", number, text)
        if not all(self.known[: 3 if "Z" in words else 2]):
            raise GcodeError("an arc from an unknown position", number, text)
        x0, y0, z0, e0 = self.position
        x1, y1, z1, e1 = self._target(*(words.get(axis) for axis in "XYZE"))
        offset = None
        if "I" in words or "J" in words:
            offset = (words.get("I", 0.0) * self.scale, words.get("J", 0.0) * self.scale)
        radius = words["R"] * self.scale if "R" in words else None
        centre = arcs.centre((x0, y0), (x1, y1), offset, radius, ccw)
        if centre is None:
            raise GcodeError("the arc's centre or radius does not fit its ends", number, text)
        points = arcs.chords((x0, y0), (x1, y1), centre, ccw)
        lengths = np.hypot(*np.diff(points, axis=0, prepend=[(x0, y0)]).T)
        share = np.cumsum(lengths) / lengths.sum()
        z, e = z0 + share * (z1 - z0), e0 + share * (e1 - e0)
        z[-1], e[-1] = z1, e1
        self.moved = True
        for row in np.column_stack([points, z, e]).tolist():
            self._travel(number, tuple(row))

    # ------------------------------------------------------------------ all other lines

    def line(self, number: int, text: bytes) -> None:
        """A line that is not a plain move."""
        coded = command(number, text)
        if coded is None:
            self._uncoded(number, text)
            return
        name, arguments = coded
        if name in commands.MOTION_WORDS:
            words = numbers(number, text, arguments, commands.MOTION_WORDS[name])
            if "F" in words:
                self._set_feed(words.pop("F"), number, text)
            if name == "G92":
                self._redefine(number, text, words)
            elif name in ("G2", "G3"):
                self._arc(number, text, words, ccw=name == "G3")
            elif words:
                self._move(number, text, *(words.get(axis) for axis in "XYZE"))
        elif name in commands.MISREAD:
            raise GcodeError(f"{name}: {commands.MISREAD[name]}", number, text)
        elif name in commands.LIMIT_WORDS:
            words = numbers(number, text, arguments, commands.LIMIT_WORDS[name])
            self._limit(name, words, number, text)
        elif name in commands.MODAL:
            self._modal(number, text, name)
        else:
            self._other(number, text, name, arguments)

    def _uncoded(self, number: int, text: bytes) -> None:
        """A comment, a Klipper macro or anything that is not G, M or T."""
        if text.startswith(commands.STAMP):
            raise GcodeError("this file has been through hframe-post already", number, text)
        if b"\0" in text:
            raise GcodeError("this is not a text file", number)
        words = uncommented(text).split()
        if not words or words == [b"%"]:
            self._passthrough(number, text, Handling.CARRY)
            return
        name = words[0].upper()
        if name == b"SET_VELOCITY_LIMIT":
            self._limit("SET_VELOCITY_LIMIT", parameters(number, text), number, text)
            return
        handling = commands.macro_handling(name)
        self._passthrough(number, text, handling)
        if handling is Handling.YIELD:
            self.known = [False, False, False]

    def _other(self, number: int, text: bytes, name: str, arguments: bytes) -> None:
        """A coded command that is neither motion, mode nor limit."""
        handling = commands.command_handling(name, arguments)
        seconds = 0.0
        if name == "G4":
            words = numbers(number, text, arguments, "PS")
            seconds = commands.dwell(words, self.firmware)
        self._passthrough(number, text, handling, seconds)
        if handling is Handling.YIELD:
            homed = [axis for axis, letter in enumerate(b"XYZ") if letter in arguments.upper()]
            for axis in homed if name == "G28" and homed else range(3):
                self.known[axis] = False
                if name == "G28":
                    self.offset[axis] = 0.0

    def _modal(self, number: int, text: bytes, name: str) -> None:
        if name in ("G90", "G91"):
            self.absolute = name == "G90"
            if self.firmware == "marlin":
                self.absolute_e = self.absolute
        elif name in ("M82", "M83"):
            self.absolute_e = name == "M82"
        elif name in ("G20", "G21"):
            self.scale = INCH if name == "G20" else 1.0
        else:
            self.xy_plane = name == "G17"
        if name != "G20":  # the output is in mm, and Klipper has no inches
            self._passthrough(number, text, Handling.CARRY)

    def _redefine(self, number: int, text: bytes, words: dict[str, float]) -> None:
        """G92: the position stays, the file's name for it changes."""
        values = words or dict.fromkeys("XYZE", 0.0)
        axes = {"XYZE".index(letter): value * self.scale for letter, value in values.items()}
        unknown = [axis for axis in axes if axis < 3 and not self.known[axis]]
        if unknown and any(axis < 3 and self.known[axis] for axis in axes):
            raise GcodeError("G92 names known and unknown positions at once", number, text)
        position = list(self.position)
        for axis, value in axes.items():
            if axis in unknown:
                position[axis], self.offset[axis], self.known[axis] = value, 0.0, True
            else:
                self.offset[axis] = position[axis] - value
        # that of E alone is harmless in the stream, whose E is relative
        only_e = all(axis == 3 for axis in axes)
        self._passthrough(number, text, Handling.CARRY if only_e else Handling.YIELD)
        x, y, z, e = position
        self.position = (x, y, z, e)

    def _limit(self, name: str, words: dict[str, float], number: int, text: bytes) -> None:
        """M201, M203, M204, M205 and M220; Klipper's SET_VELOCITY_LIMIT has no words."""
        for letter, value in words.items():
            if value < 0.0 or (value == 0.0 and not commands.may_be_zero(name, letter)):
                raise GcodeError(f"{letter} must be positive", number, text)
        if name == "M220":
            self.factor = words.get("S", 100.0 * self.factor) / 100.0
        elif self.file_limits:
            if self.asked.changes_axes(name, words):
                self._flush()
            self.asked.command(name, words)

    # ------------------------------------------------------------------ items

    def _passthrough(
        self,
        number: int,
        text: bytes,
        handling: Handling,
        seconds: float = 0.0,
        filament: float = 0.0,
    ) -> None:
        """A carried line among gathered moves is a mark; all others end the block of moves."""
        if handling is Handling.CARRY and self.rows:
            self.marks.append(Mark(len(self.rows), text))
            return
        self._flush()
        user = ModalState(
            self.absolute, self.absolute_e, self.position[3] - self.offset[3], self.feed,
            (self.offset[0], self.offset[1], self.offset[2]),
        )  # fmt: skip
        self.out.append(Passthrough(number, text, handling, user, seconds, filament))

    def _flush(self) -> None:
        """The gathered moves become one item."""
        if not self.rows:
            return
        table = np.array(self.rows)
        points = np.vstack([self.start, table[:, 1:5]])
        speed, acceleration, corner = (frozen(table[:, k].copy()) for k in (5, 6, 7))
        line = table[:, 0].astype(np.int64)
        self.out.append(
            Moves(
                line,
                frozen(points),
                speed,
                acceleration,
                corner,
                self.asked.limits,
                tuple(self.marks),
            )
        )
        self.rows, self.marks = [], []

    def finish(self, number: int) -> None:
        """The end of the file: what is gathered, and the modes to leave behind."""
        if not number:
            raise GcodeError("the file is empty")
        if not self.moved:
            raise GcodeError("there is not a single move in this file", number)
        self._passthrough(number, b"", Handling.YIELD)
