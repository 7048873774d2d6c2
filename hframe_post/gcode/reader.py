"""The reader of G-code: text → moves, moves while x and y are at rest, and other lines.

Rules:
 1. A line that is not motion passes through byte for byte and in order.
 2. A line that could be misread as motion is an error; nothing is guessed.
 3. After a line whose motion cannot be known (homing, a macro, a tool change) the position
    is unknown, and the next move passes through to the firmware.
 4. Lines that only set limits or the feed-rate factor are applied here and do not pass through:
    inside a dense stream the firmware would apply them a second time. Speeds of z and filament
    (M203) pass, where the firmware obeys them.
 5. After an object that may be excluded, the next move of x and y passes through in one piece.
 6. Firmware retraction becomes a move of filament where the profile gives its settings.
 7. What a tool prints that the profile has no model of passes through to the firmware.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from itertools import chain, islice

import numpy as np

from hframe_post.errors import GcodeError, LeftAloneError
from hframe_post.firmware.code import plain
from hframe_post.gcode import commands
from hframe_post.gcode.batching import (
    MAX_FILAMENT_MM,
    MAX_FILAMENT_PER_PATH,
    MIN_FEED_MM_S,
    MIN_PATH_MM,
    ItemBuilder,
    PlainLines,
    known_names,
)
from hframe_post.gcode.commands import (
    Line,
    Words,
    command,
    limit_words,
    name_and_arguments,
    numbers,
    numbers_among,
    uncommented,
)
from hframe_post.gcode.curves import MAX_COORDINATE_MM, curve
from hframe_post.gcode.extrusion import FirmwareRetraction, is_absolute
from hframe_post.gcode.lines import Lines
from hframe_post.gcode.objects import Objects
from hframe_post.gcode.state import ReadOptions, State
from hframe_post.model.kinematics import Trapezoid
from hframe_post.stream.types import Handling, Item, Passthrough, Position

MAX_DWELL_S = 24 * 3600.0  # s
RESOLUTION_MM = 1e-3  # mm; the resolution of a file
LINES_TO_G11 = 500  # lines within which a G10 has its G11
TOOL = re.compile(r"T\d+")
# causes of uncompensated moves other than commands
START_OF_FILE = "the start"
CHANGE_OF_OBJECT = "a change of object"


def read(lines: Iterable[bytes], options: ReadOptions) -> Iterator[Item]:
    """Yield the items of a G-code file, streaming. Raises GcodeError, LimitError."""
    source = Lines(lines, options.dialect.cr_ends_lines)
    reader = _Reader(source, options)
    ready = reader.items.ready
    for line in source:
        reader.apply(line)
        yield from ready
        ready.clear()
        while reader.plain_lines.take(reader.items):
            yield from ready
            ready.clear()
        yield from ready
        ready.clear()
    reader.finish()
    yield from ready


class _Reader:
    """Interpreter of lines: each one changes ``state``, and what it asks for goes to ``items``."""

    def __init__(self, source: Lines, options: ReadOptions) -> None:
        self._source, self._options, self._dialect = source, options, options.dialect
        self._state = State(options)
        self._objects = Objects(options.dialect, source, known_names(options))
        self._retraction = FirmwareRetraction(options.retraction, options.dialect)
        self.plain_lines = PlainLines(self._state, self._objects, options)
        self._any_motion = False  # requested so far, even from unknown positions
        self._macro = ""  # the last one that may have set modes
        self._other_tool = False  # prints, of which the profile has no model
        self._cause = START_OF_FILE  # of the unknown position
        self.items = ItemBuilder(self._state)

    def apply(self, line: Line) -> None:
        """Apply one line, whatever it is. Raises GcodeError, LimitError."""
        coded = command(line)
        if coded is None:
            self._apply_uncoded(line)
            return
        name, arguments = coded
        if name in commands.MOTION_WORDS:
            self._apply_motion(line, name, numbers(line, arguments, commands.MOTION_WORDS[name]))
        elif name in commands.UNSUPPORTED:
            raise line.error(f"{name}: {commands.UNSUPPORTED[name]} are not supported")
        elif name in commands.LIMIT_WORDS:
            self._apply_limit(line, name, arguments)
        elif name in commands.MODAL:
            self._state.set_mode(name)
            if name != "G20":  # the output is in mm, and Klipper has no inches
                self._pass_through(line, Handling.CARRY)
        elif name == "G4":
            self._apply_dwell(line, arguments)
        else:
            self._apply_other(line, name, arguments)

    def finish(self) -> None:
        """Apply the end of the file: complete the last item, and report the final modes."""
        number = self._source.number
        if not number:
            raise GcodeError("the file is empty: slice again")
        if not (self._any_motion or self.items.any_motion):
            cause = "there is not a single move in this file: give the G-code of a slicer"
            raise GcodeError(cause, number)
        self._pass_through(Line(number, b""), Handling.RELEASE)

    # ------------------------------------------------------------------ motion

    def _apply_motion(self, line: Line, name: str, words: Words) -> None:
        state = self._state
        if "F" in words:
            state.set_feed(line, words.pop("F"))
            if state.feed < MIN_FEED_MM_S:
                raise line.error(f"the feed rate must be at least {60.0 * MIN_FEED_MM_S:g} mm/min")
        if name == "G92":
            state.rename_position(line, words)
            # The stream's E is relative, so a new name of E alone is harmless in it.
            only_e = words.keys() == {"E"}
            state.e_named |= "E" in words
            self._pass_through(line, Handling.CARRY if only_e else Handling.RELEASE)
            return
        straight = name in ("G0", "G1")
        if straight and not words:
            return
        start, asked = state.position, self._end(line, words)
        end = self._within_endstops(line, asked)
        elsewhere = state.scale == 1.0 and self._objects.left  # the output is in mm
        lifts = end[2] != start[2]
        if not state.starts_known(words):
            self._pass_move_through(line, name, words, end, self._cause)
        elif end[:2] != start[:2] and elsewhere and (name != "G5" or self._dialect.splines):
            self._pass_move_through(line, name, words, end, CHANGE_OF_OBJECT)
        elif not straight and not (elsewhere and lifts and end[3] == start[3]):
            for x, y, z, e in curve(line, name, words, state, asked).tolist():
                self._travel(line, self._within_endstops(line, (x, y, z, e)))
        elif end[:2] != start[:2]:
            self._travel(line, end)
        elif end != start:  # a lift in turns as well, whose first chord could be far away
            if lifts:
                state.bed.check(line, 2, end[2])
            self._stand(line, end)
            state.position = end

    def _end(self, line: Line, words: Words) -> Position:
        state = self._state
        if "E" in words and not state.e_mode_known:
            state.set_e_mode(self._detect_absolute_e(line))
        end = state.target(words)
        self._any_motion = True
        if not (min(end) > -MAX_COORDINATE_MM and max(end) < MAX_COORDINATE_MM):
            raise line.error("a coordinate is too large")
        if abs(end[3] - state.position[3]) > MAX_FILAMENT_MM:
            raise line.error(f"more than {MAX_FILAMENT_MM:g} mm of filament in one move")
        return end

    def _within_endstops(self, line: Line, asked: Position) -> Position:
        """Return where the firmware ends a move, and note where that is not as asked."""
        if (end := self._state.within_endstops(asked)) != asked:
            self._options.note(
                "endstops", f"line {line.number} leads {math.dist(end[:3], asked[:3]):.3g} mm off "
                "the bed: the firmware's soft endstops stop it at the edge, as sliced"
            )  # fmt: skip
        return end

    def _travel(self, line: Line, end: Position) -> None:
        """Add a move in which x or y changes, unless it is too short to be one."""
        state = self._state
        for axis in range(3):
            state.bed.check(line, axis, end[axis])
        start = state.position
        path, filament = math.dist(start[:3], end[:3]), abs(end[3] - start[3])
        if filament > MAX_FILAMENT_PER_PATH * path:  # the filament decides how long that takes
            fed = (*start[:3], end[3])
            self._stand(line, fed)
            start, moves = fed, path >= RESOLUTION_MM
        else:
            moves = path > MIN_PATH_MM
        if moves:
            self._objects.moved()
            self.items.add_move(line.number, start, end, state.speed)
        state.position = end

    def _stand(self, line: Line, end: Position) -> None:
        state, start = self._state, self._state.position
        extrudes = end[3] != start[3]
        acceleration = state.acceleration if extrudes else state.travel_acceleration
        self.items.stand(line.number, start, end, state.speed, acceleration)

    def _pass_move_through(
        self, line: Line, name: str, words: Words, end: Position, cause: str
    ) -> None:
        """Leave a move to the firmware, which may be elsewhere; what it names is known then."""
        state = self._state
        if name == "G5" and not self._dialect.splines:
            raise line.error("a spline from an unknown position; add a G1 with X and Y before it")
        if state.scale != 1.0:  # the output is in mm
            raise line.error("a move in inches from an unknown position; use mm (G21) here")
        if state.absolute and not self._other_tool:
            for axis, letter in enumerate("XYZ"):
                if letter in words:
                    state.bed.check(line, axis, end[axis])
        path, filament = math.dist(state.position[:3], end[:3]), end[3] - state.position[3]
        place = end if cause == CHANGE_OF_OBJECT else None
        seconds = self._seconds(end) if path else 0.0
        self._pass_through(line, Handling.RELEASE, seconds, filament, path, cause, place)
        if path:
            self._objects.moved()
        state.arrive(end, words)
        if self._other_tool:
            state.forget()

    def _seconds(self, end: Position) -> float:
        """Return the duration of a move from rest to rest, from where the file last was."""
        state = self._state
        speed, a = np.array([state.speed]), np.array([state.travel_acceleration])
        state.others.lower(speed, a, np.array([state.position, end]))
        return Trapezoid(
            math.dist(state.position[:3], end[:3]), float(speed[0]), float(a[0])
        ).seconds

    # ------------------------------------------------------------------ other commands

    def _apply_limit(self, line: Line, name: str, arguments: bytes) -> None:
        words = limit_words(line, name, arguments)
        if name == "M220":
            self._state.set_factor(line, arguments, words)
        elif self._options.obeys(name):
            self._state.set_limits(line, name, words)
            of_others = [a + plain(words[a], 3) for a in "ZE" if name == "M203" and a in words]
            if of_others:  # the stream's lines set those of x and y
                text = " ".join([name, *of_others]).encode()
                self._pass_through(Line(line.number, text), Handling.CARRY)

    def _apply_dwell(self, line: Line, arguments: bytes) -> None:
        seconds = self._dialect.dwell(numbers_among(line, arguments, "PS"))
        if not 0.0 <= seconds <= MAX_DWELL_S:
            raise line.error(f"a dwell must last from 0 to {MAX_DWELL_S / 3600.0:g} h")
        self._pass_through(line, Handling.REST, seconds)

    def _apply_uncoded(self, line: Line) -> None:
        """Apply a comment, a Klipper macro or anything that is not G, M or T."""
        if line.text.startswith(commands.STAMP):
            stamp = line.text.removeprefix(commands.STAMP).decode("utf-8", "replace").strip()
            raise LeftAloneError("this file is converted already", line.number, stamp)
        if line.text.strip() == commands.OFF:
            raise LeftAloneError("the file says that it is not to be converted", line.number)
        if b"\0" in line.text:
            raise GcodeError("this is not a text file", line.number)
        if uncommented(line.text).strip() in (b"", b"%"):
            self._pass_through(line, Handling.CARRY)
            return
        name, _ = name_and_arguments(line)
        if name == commands.LIMITS:
            self._apply_limit(line, name, b"")
        else:
            self._apply_other(line, name)

    def _apply_other(self, line: Line, name: str, arguments: bytes = b"") -> None:
        self._state.set_advance(line.text)
        if name == "M211":
            self._state.set_endstops(numbers_among(line, arguments, "S"))
        self._retraction.apply(line, name, arguments)
        retracts = name in ("G10", "G11") and not arguments.strip()
        if retracts and self._apply_retraction(line, name):
            return
        effect = self._options.vocabulary.effect(name, arguments)
        waits = name in ("G10", "G11") and effect is commands.Effect.WAITS
        seconds = self._retraction.duration(name) if waits else 0.0
        # before the line passes: what it leaves holds when the stream goes on
        axes = self._state.home(arguments) if name == "G28" else range(3)
        self._pass_through(line, effect.handling, seconds)
        if effect not in (commands.Effect.UNKNOWN, commands.Effect.OTHER_TOOL):
            return
        if effect is commands.Effect.OTHER_TOOL or TOOL.fullmatch(name):
            self._other_tool = effect is commands.Effect.OTHER_TOOL
        if not self._other_tool or effect is commands.Effect.OTHER_TOOL:
            self._cause = name[:40]
        self._retraction.forget()
        self._state.forget(axes)
        if self._dialect.may_be_macro(name):
            self._macro, self._state.e_named = name[:40], False

    def _apply_retraction(self, line: Line, name: str) -> bool:
        """Turn G10 or G11 into a move of filament; return False if it must pass through."""
        state = self._state
        paired = self._options.retraction is not None and all(state.known) and self._g11_follows()
        move = self._retraction.move(name, paired)
        if move is None:
            return False
        filament, speed = move
        if filament:
            start = state.position
            state.add_filament(filament)
            end, speed = state.position, speed * state.factor
            self.items.stand(line.number, start, end, speed, state.acceleration)
        return True

    def _g11_follows(self) -> bool:
        """Return whether a G11 comes before anything that may move the machine or retract."""
        known = {"", commands.LIMITS, *commands.MODAL}
        known |= commands.MOTION_WORDS.keys() | commands.LIMIT_WORDS.keys()
        for line in islice(self._source.ahead(), LINES_TO_G11):
            name, arguments = name_and_arguments(line)
            if name == "G11" and not arguments.strip():
                return True
            effect = self._options.vocabulary.effect(name, arguments)
            if name not in known and effect.handling is Handling.RELEASE:
                return False
        return False

    # ------------------------------------------------------------------ pass-through lines

    def _pass_through(
        self, line: Line, handling: Handling, seconds: float = 0.0, filament: float = 0.0,
        path: float = 0.0, cause: str = "", end: Position | None = None,
    ) -> None:  # fmt: skip
        """Add a pass-through line; see ``Passthrough`` for the arguments."""
        state = self._state
        self._objects.read(line.text)
        unclear = self._macro and not state.e_mode_known
        if unclear and self.items.any_motion and handling is Handling.RELEASE:
            # The stream has modes of its own; to leave it, those of the file must be known.
            state.set_e_mode(self._detect_absolute_e(line))
        if handling is Handling.CARRY and self.items.carry(line.text):
            return
        modes = state.modal_state()
        self.items.add_line(
            Passthrough(
                line.number, line.text, handling, modes, seconds, filament, path, cause, end
            )
        )

    def _detect_absolute_e(self, line: Line) -> bool:
        state = self._state
        x, y, _, e = (a - b for a, b in zip(state.position, state.offset, strict=True))
        known = all(state.known[:2]) and state.absolute
        absolute = is_absolute(
            chain([line], self._source.ahead()), x if known else math.nan, y if known else math.nan,
            e if state.e_named else math.nan,
        )  # fmt: skip
        if absolute is False and self._macro:
            return False
        if absolute or (absolute is None and not self._macro):
            return True
        why = f"{self._macro} may have" if self._macro else "its numbers look relative"
        raise line.error(
            "it is unclear whether E is absolute (M82) or relative (M83): nothing sets it before "
            f"this line, but {why}. Add the one that holds above it, or say "
            "'hframe-post convert --extrusion absolute' or '… relative'"
        )
