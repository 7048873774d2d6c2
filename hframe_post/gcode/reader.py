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

import math
from collections.abc import Iterable, Iterator
from itertools import chain, islice

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import GcodeError
from hframe_post.gcode import arcs, commands
from hframe_post.gcode.bed import Bed
from hframe_post.gcode.commands import Effect, Words
from hframe_post.gcode.coordinates import AXES, Coordinates, Word
from hframe_post.gcode.extrusion import is_absolute
from hframe_post.gcode.feed import Feed
from hframe_post.gcode.gathering import Gathering
from hframe_post.gcode.lexer import (
    PLAIN_MOVE,
    Command,
    Line,
    command,
    numbers,
    numbers_among,
    parameters,
    plain_words,
    uncommented,
)
from hframe_post.gcode.limits import RequestedLimits
from hframe_post.gcode.lines import Lines
from hframe_post.gcode.options import ReadOptions
from hframe_post.gcode.plain_moves import FARTHEST, MOST_FILAMENT, NO_PATH, STEEPEST, PlainMoves
from hframe_post.gcode.retraction import MACRO, PAIRED, PARAMETERS, SETTINGS, FirmwareRetraction
from hframe_post.stream.types import Handling, Item, Passthrough, Position, Standing

LONGEST_DWELL = 24 * 3600.0  # s
MOST_TURNS = 100  # of an arc
SHORTEST = 1e-3  # mm that can be written
IMPOSSIBLE = 1e3  # mm of filament per mm of path
NOWHERE = [None] * 4  # the places of a line that only sets F
OUT_OF_BOUNDS = "a coordinate is out of all bounds"
AT_THE_START = "the start"  # why the first moves' place is unknown


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
            reader.plain_move(line, match.groups())
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
        self._bed = Bed(options.travel)
        self._place = Coordinates(options.dialect, options.extrusion)
        self._limits = RequestedLimits(options.dialect)
        self._feed = Feed(options.dialect)
        self._retraction = FirmwareRetraction(options.retraction, options.dialect)
        self._moved = self._ran_macro = False
        self._cause = AT_THE_START
        self.items = Gathering(self._limits)
        self.plain = PlainMoves(source, self._place, self._feed, self._bed, self.items)

    # ------------------------------------------------------------------ moves

    def plain_move(self, line: Line, words: tuple[bytes | None, ...]) -> None:
        """G0 or G1 with its words in the usual order: the hot path."""
        f, *places = plain_words(line, words)
        if f is not None:
            self._feed.set(line, f, self._place.scale)
        if places != NOWHERE:
            self._move(line, *places)

    def _move(self, line: Line, x: Word, y: Word, z: Word, e: Word) -> None:
        """One straight move to the file's coordinates."""
        place = self._place
        old, new = place.position, self._target(line, x, y, z, e)
        if not place.allow(z):
            self._as_it_stands(line, new, math.dist(old[:3], new[:3]), (x, y, z))
        elif new[0] != old[0] or new[1] != old[1]:
            self._travel(line, new)
        elif new != old:
            if new[2] != old[2]:
                self._bed.check(line, 2, new[2])
            top = self._limits.axes.velocity[2 if new[2] != old[2] else 3]
            self.items.stand(Standing(line.number, old, new, min(self._feed.speed, top)))
            place.position = new

    def _target(self, line: Line, x: Word, y: Word, z: Word, e: Word) -> Position:
        """Where a move leads, on the bed or not."""
        if e is not None and not self._place.e_told:
            self._place.tell_e(self._e_is_absolute(line))
        new = self._place.target(x, y, z, e)
        self._moved = True
        if not (min(new) > -FARTHEST and max(new) < FARTHEST):
            raise line.error(OUT_OF_BOUNDS)
        if abs(new[3] - self._place.position[3]) > MOST_FILAMENT:
            raise line.error(f"more than {MOST_FILAMENT:g} mm of filament in one move")
        return new

    def _travel(self, line: Line, new: Position) -> None:
        """A move in which x or y travels joins the gathered ones."""
        x, y, z, e = new
        least, greatest = self._bed.least, self._bed.greatest
        if not (
            least[0] <= x <= greatest[0]
            and least[1] <= y <= greatest[1]
            and least[2] <= z <= greatest[2]
        ):
            for axis in range(3):
                self._bed.check(line, axis, new[axis])
        old = self._place.position
        path, filament = math.dist(old[:3], new[:3]), abs(e - old[3])
        if path < SHORTEST and filament > STEEPEST * path:  # then it is fed in one place
            speed = min(self._feed.speed, self._limits.axes.velocity[3])
            self.items.stand(Standing(line.number, old, (*old[:3], e), speed))
        elif filament > IMPOSSIBLE * path:
            raise line.error(f"{filament:.3g} mm of filament along {path:.3g} mm of path")
        elif path > NO_PATH:
            self.items.travel(line.number, old, new, self._feed.speed)
        self._place.position = new

    def _as_it_stands(
        self, line: Line, new: Position, path: float, words: tuple[Word, Word, Word]
    ) -> None:
        """A move from an unknown place goes to the firmware; what it names is known after it."""
        place = self._place
        if place.scale != 1.0:  # the output is in mm
            raise line.error("a move in inches from an unknown position")
        if place.absolute:
            for axis, word in enumerate(words):
                if word is not None:
                    self._bed.check(line, axis, new[axis])
        filament = new[3] - place.position[3]
        self._passthrough(line, Handling.RELEASE, filament=filament, path=path, cause=self._cause)
        place.arrive(new, *words)

    # ------------------------------------------------------------------ curves

    def _arc(self, line: Line, words: Words, ccw: bool) -> None:
        """G2 or G3. P counts the turns that it begins."""
        place = self._place
        if not place.xy_plane:
            raise line.error("arcs outside the x-y plane are not supported")
        turns = words.pop("P", 1.0) or 1.0
        if turns != int(turns) or not 1 <= turns <= MOST_TURNS:
            raise line.error(f"P must be a number of turns, 1 to {MOST_TURNS}")
        start = place.position
        x, y, z, e = (words.get(axis) for axis in AXES)
        new = self._target(line, x, y, z, e)
        ends = start[:2], new[:2]
        centre = None
        if "I" in words or "J" in words:
            i, j = (words.get(letter, 0.0) * place.scale for letter in "IJ")
            centre = start[0] + i, start[1] + j
        elif "R" in words:
            centre = arcs.centre_of_radius(*ends, words["R"] * place.scale, ccw)
        if not place.allow(z):  # then it cannot be checked either
            self._as_it_stands(line, new, math.dist(start[:3], new[:3]), (x, y, z))
            return
        arc = arcs.arc(*ends, centre, ccw, int(turns)) if centre else None
        if arc is None:
            raise line.error("the arc's centre or radius does not fit its ends")
        if not arc.length < FARTHEST:
            raise line.error(OUT_OF_BOUNDS)
        self._curve(line, new, *arc.chords())

    def _spline(self, line: Line, words: Words) -> None:
        """G5: a cubic Bézier curve, its control points relative to its ends."""
        place = self._place
        start = place.position
        x, y, z, e = (words.get(axis) for axis in AXES)
        new = self._target(line, x, y, z, e)
        if not place.allow(z):
            if not self._dialect.splines:
                raise line.error("a spline from an unknown position")
            self._as_it_stands(line, new, math.dist(start[:3], new[:3]), (x, y, z))
            return
        i, j, p, q = (words.get(letter, 0.0) * place.scale for letter in "IJPQ")
        ends = (start[0], start[1]), (new[0], new[1])
        first, second = (ends[0][0] + i, ends[0][1] + j), (ends[1][0] + p, ends[1][1] + q)
        if max(map(abs, (*first, *second))) > FARTHEST:
            raise line.error(OUT_OF_BOUNDS)
        self._curve(line, new, *arcs.spline(ends[0], first, second, ends[1]))

    def _curve(self, line: Line, new: Position, points: Array, share: Array) -> None:
        """Chords to points (k, 2); z and e grow with the share (k,) of the curve."""
        _, _, z0, e0 = self._place.position
        z, e = z0 + share * (new[2] - z0), e0 + share * (new[3] - e0)
        rows = np.column_stack([points, z, e]).tolist()
        rows[-1] = new
        for row in rows:
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
            words = numbers_among(line, coded.arguments, commands.LIMIT_WORDS[coded.name])
            if coded.name == "M220":
                self._feed.factor(line, coded.arguments, words)
            else:
                self._limit(line, coded.name, words)
        elif coded.name in commands.MODAL:
            self._place.set_mode(coded.name)
            if coded.name != "G20":  # the output is in mm, and Klipper has no inches
                self._passthrough(line, Handling.CARRY)
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
            self._passthrough(line, Handling.CARRY if only_e else Handling.RELEASE)
        elif coded.name in ("G2", "G3"):
            self._arc(line, words, ccw=coded.name == "G3")
        elif coded.name == "G5":
            self._spline(line, words)
        elif words:
            self._move(line, *(words.get(axis) for axis in AXES))

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
        self._passthrough(line, Handling.REST, seconds)

    def _uncoded(self, line: Line) -> None:
        """A comment, a Klipper macro or anything that is not G, M or T."""
        if line.text.startswith(commands.STAMP):
            raise line.error("this file has been through hframe-post already")
        if b"\0" in line.text:
            raise GcodeError("this is not a text file", line.number)
        words = uncommented(line.text).split(maxsplit=1)
        if not words or words == [b"%"]:
            self._passthrough(line, Handling.CARRY)
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
        self._passthrough(line, effect.handling, self._retraction.seconds(name) if waits else 0.0)
        if effect is not Effect.UNKNOWN:
            return
        self._cause = name[:40]
        self._retraction.lost()
        if name == "G28":
            homed = [axis for axis in range(3) if AXES[axis].encode() in arguments.upper()]
            self._place.forget(homed or range(3), homed=True)
        else:
            self._place.forget()
            self._ran_macro |= name[:1] not in "GMT" or not name[1:].isdigit()

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

    def _e_is_absolute(self, line: Line) -> bool:
        """What E is, in a file that has not said so before the first."""
        absolute = is_absolute(chain([line], self._source.ahead()))
        if absolute is False and self._ran_macro:
            return False
        if absolute or (absolute is None and not self._ran_macro):
            return True
        raise line.error(
            "nothing before tells whether E is absolute (M82) or relative (M83), and a macro may "
            "have set it: say --extrusion absolute or --extrusion relative"
        )

    def _passthrough(
        self,
        line: Line,
        handling: Handling,
        seconds: float = 0.0,
        filament: float = 0.0,
        path: float = 0.0,
        cause: str = "",
    ) -> None:
        """A line that passes as it stands, with what the file believes of the firmware.

        The stream has modes of its own. To leave it those of the file must be known, which a
        macro before the first motion may have set.
        """
        guessed = self._ran_macro and not self._place.e_told
        if guessed and self.items.any_motion and handling is Handling.RELEASE:
            self._place.tell_e(self._e_is_absolute(line))
        state = self._place.state(self._feed.rate)
        item = Passthrough(line.number, line.text, handling, state, seconds, filament, path, cause)
        self.items.pass_through(item)

    def finish(self, number: int) -> None:
        """The end of the file: what is gathered, and the modes to leave behind."""
        if not number:
            raise GcodeError("the file is empty")
        if not (self._moved or self.plain.taken):
            raise GcodeError("there is not a single move in this file", number)
        self._passthrough(Line(number, b""), Handling.RELEASE)
