"""Reads G-code: text → moves, moves in which x and y stand, and lines that pass through.

Rules:
 1. A line that is not motion passes byte for byte and in order.
 2. A line that would be misread as motion is an error, never a guess.
 3. After a line whose motion cannot be known (homing, a macro, a tool change) the position
    is unknown, and the next move goes to the firmware as it stands.
 4. Lines that only set limits or the feed-rate factor are obeyed here and do not pass:
    inside a dense stream the firmware would obey them a second time.
 5. Firmware retraction becomes a move of filament where the profile tells what it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice

from hframe_post.errors import GcodeError
from hframe_post.gcode import commands
from hframe_post.gcode.batching import Gathering
from hframe_post.gcode.bed import Bed
from hframe_post.gcode.commands import Effect, Words
from hframe_post.gcode.coordinates import AXES, Coordinates
from hframe_post.gcode.feed import Feed
from hframe_post.gcode.lexer import (
    PLAIN_MOVE,
    Command,
    Line,
    command,
    numbers,
    numbers_among,
    parameters,
    uncommented,
)
from hframe_post.gcode.limits import RequestedLimits
from hframe_post.gcode.lines import Lines
from hframe_post.gcode.motion import Motion
from hframe_post.gcode.options import ReadOptions
from hframe_post.gcode.passthrough import Passing
from hframe_post.gcode.plain_moves import PlainMoves
from hframe_post.gcode.retraction import MACRO, PAIRED, PARAMETERS, SETTINGS, FirmwareRetraction
from hframe_post.stream.types import Handling, Item, Standing

LONGEST_DWELL = 24 * 3600.0  # s


def read(lines: Iterable[bytes], options: ReadOptions) -> Iterator[Item]:
    """Items of a G-code file, streaming. lines: with or without line ends.

    Raises GcodeError, LimitError.
    """
    source = Lines(lines, options.dialect.cr_ends_lines)
    reader = _Reader(options, source)
    out, plain = reader.items.out, reader.plain
    for line in source:
        match = PLAIN_MOVE.match(line.text)
        if match is None:
            reader.line(line)
        else:
            reader.motion.plain(line, match.groups())
        if out:
            yield from out
            out.clear()
        while plain.take():
            yield from out
            out.clear()
    reader.finish(source.number)
    yield from out


class _Reader:
    """Takes line after line; what it has read is in ``items``."""

    def __init__(self, options: ReadOptions, source: Lines) -> None:
        self._options, self._source = options, source
        self._dialect = options.dialect
        self._place = Coordinates(options.dialect, options.extrusion)
        self._limits = RequestedLimits(options.dialect)
        self._feed = Feed(options.dialect)
        self._retraction = FirmwareRetraction(options.retraction, options.dialect)
        self.items = Gathering(self._limits)
        self._passing = Passing(source, self._place, self._feed, self.items)
        bed, splines = Bed(options.travel), options.dialect.splines
        self.motion = Motion(
            self._place, self._feed, bed, self._limits, self.items, self._passing, splines
        )
        self.plain = PlainMoves(source, self._place, self._feed, bed, self.items)

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
            words = numbers_among(line, coded.arguments, commands.LIMIT_WORDS[coded.name])
            if coded.name == "M220":
                self._feed.factor(line, coded.arguments, words)
            else:
                self._limit(line, coded.name, words)
        elif coded.name in commands.MODAL:
            self._place.set_mode(coded.name)
            if coded.name != "G20":  # the output is in mm, and Klipper has no inches
                self._passing.line(line, Handling.CARRY)
        elif coded.name == "G4":
            self._dwell(line, coded)
        else:
            self._other(line, coded.name, coded.arguments)

    def _motion(self, line: Line, coded: Command) -> None:
        """G0, G1, G2, G3, G5 and G92, written in any way."""
        words = numbers(line, coded.arguments, commands.MOTION_WORDS[coded.name])
        if "F" in words:
            self._feed.set(line, words.pop("F"), self._place.scale)
        if coded.name == "G92":
            if not self._place.redefine(words):
                raise line.error("G92 names known and unknown positions at once")
            # that of E alone is harmless in the stream, whose E is relative
            only_e = words.keys() == {"E"}
            self._passing.line(line, Handling.CARRY if only_e else Handling.RELEASE)
        elif coded.name in ("G2", "G3"):
            self.motion.arc(line, words, ccw=coded.name == "G3")
        elif coded.name == "G5":
            self.motion.spline(line, words)
        elif words:
            self.motion.straight(line, *(words.get(axis) for axis in AXES))

    def _limit(self, line: Line, name: str, words: Words) -> None:
        """M201, M203, M204, M205 or SET_VELOCITY_LIMIT."""
        obeyed = self._options.limits
        if obeyed == "file-all" or (obeyed == "file" and name in self._dialect.obeyed):
            if name in ("M201", "M203") or "VELOCITY" in words or "T" in words:
                self.items.flush()  # these limits hold for all moves of an item
            self._limits.take(line, name, words)

    def _dwell(self, line: Line, coded: Command) -> None:
        seconds = self._dialect.dwell(numbers_among(line, coded.arguments, "PS"))
        if not 0.0 <= seconds <= LONGEST_DWELL:
            raise line.error(f"a dwell lasts from 0 to {LONGEST_DWELL / 3600.0:g} h")
        self._passing.line(line, Handling.REST, seconds)

    def _uncoded(self, line: Line) -> None:
        """A comment, a Klipper macro or anything that is not G, M or T."""
        if line.text.startswith(commands.STAMP):
            raise line.error("this file has been through hframe-post already")
        if b"\0" in line.text:
            raise GcodeError("this is not a text file", line.number)
        words = uncommented(line.text).split(maxsplit=1)
        if not words or words == [b"%"]:
            self._passing.line(line, Handling.CARRY)
            return
        name = words[0].decode("latin-1").upper()
        if name == commands.LIMITS:
            self._limit(line, name, parameters(line, commands.LIMIT_PARAMETERS))
        else:
            self._other(line, name)

    def _other(self, line: Line, name: str, arguments: bytes = b"") -> None:
        """A command or macro that is neither motion, mode nor limit."""
        if self._retracts(line, name, arguments):
            return
        effect = self._options.vocabulary.effect(name, arguments)
        if name == "M486" and self._dialect.rejoins:  # S goes to an object, which may be left out
            effect = Effect.WAITS
        waits = name in ("G10", "G11") and effect is Effect.WAITS
        self._passing.line(line, effect.handling, self._retraction.seconds(name) if waits else 0.0)
        if effect is not Effect.UNKNOWN:
            return
        self._passing.cause = name[:40]
        self._retraction.lost()
        if name == "G28":
            homed = [axis for axis in range(3) if AXES[axis].encode() in arguments.upper()]
            self._place.forget(homed or range(3), homed=True)
        else:
            self._place.forget()
            self._passing.ran_macro |= name[:1] not in "GMT" or not name[1:].isdigit()

    def _retracts(self, line: Line, name: str, arguments: bytes) -> bool:
        """Whether it is a G10 or G11 that is made a move of filament here.

        The file's own count of filament knows nothing of it.
        """
        if name == MACRO:
            self._retraction.set(name, parameters(line, PARAMETERS))
        elif name in SETTINGS:
            self._retraction.set(name, numbers_among(line, arguments, SETTINGS[name]))
        place = self._place
        if name not in ("G10", "G11") or arguments.strip():
            return False
        paired = self._options.retraction is not None and all(place.known) and self._paired()
        if (moved := self._retraction.of(name, paired)) is None:
            return False
        filament, speed = moved
        if filament:
            x, y, z, e = old = place.position
            place.position = new = (x, y, z, e + filament)
            ox, oy, oz, oe = place.offset
            place.offset = (ox, oy, oz, oe + filament)
            speed = min(speed * self._feed.multiplier, self._limits.axes.velocity[3])
            self.items.stand(Standing(line.number, old, new, speed))
        return True

    def _paired(self) -> bool:
        """Whether a G11 comes before anything that may move the machine or retract itself."""
        known = commands.MOTION_WORDS.keys() | commands.LIMIT_WORDS.keys() | commands.MODAL
        for line in islice(self._source.ahead(), PAIRED):
            coded = command(line)
            if coded is not None:
                name, arguments = coded.name, coded.arguments
            else:
                words = uncommented(line.text).split(maxsplit=1)
                name, arguments = words[0].decode("latin-1").upper() if words else "", b""
            if name == "G11" and not arguments.strip():
                return True
            if not name or name == commands.LIMITS or name in known:
                continue
            if self._options.vocabulary.effect(name, arguments).handling is Handling.RELEASE:
                return False
        return False

    def finish(self, number: int) -> None:
        """The end of the file: what is gathered, and the modes to leave behind."""
        if not number:
            raise GcodeError("the file is empty")
        if not (self.motion.any or self.plain.taken):
            raise GcodeError("there is not a single move in this file", number)
        self._passing.line(Line(number, b""), Handling.RELEASE)
