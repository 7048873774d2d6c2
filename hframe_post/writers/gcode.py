"""Samples → a dense G-code stream.

The command becomes a polyline in time, with segments as the firmware wants them. Coordinates
are rounded to 0.001 mm, or finer if asked, and filament to 0.00001 mm, and written as differences
of rounded absolute values, so that no rounding adds up. Feed rates allow for the firmware's ramps
inside every segment, so that it takes the segment's time; the next segments make up for what it
is late by, as far as rounding tells. A retraction, a lift or a wait is one line at rest.

Three passes make the text, each a generator:

1. ``machine``: samples → typed commands, with places in output units;
2. ``pace``: feed rates and dwells, which keep the machine in time;
3. here: lines of G-code.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache

from hframe_post.arrays import E, Z
from hframe_post.errors import HframeError
from hframe_post.firmware.code import Code, plain
from hframe_post.firmware.motion import MotionRules
from hframe_post.native.digits import TOO_LONG, least_too_long, motion_lines
from hframe_post.stream.tally import tallied
from hframe_post.stream.types import Position, Samples
from hframe_post.writers.carried import STOP
from hframe_post.writers.decimation import Units
from hframe_post.writers.machine import LimitChange, Machine, PlacedMove, Text
from hframe_post.writers.print_time import Deferred, Output
from hframe_post.writers.timing import TimedCommand, TimedMotion, TimedMove, Timing

TEXT_AT_ONCE = 1 << 16  # bytes


@dataclass(frozen=True, slots=True)
class GcodeSummary:
    """Numbers of a stream: lines, lines of motion in the busiest second, filament (mm).

    late: seconds by which the machine takes longer than the samples.
    """

    lines: int = 0
    busiest_second: int = tallied(0, max)
    filament: float = 0.0
    late: float = 0.0


class GcodeWriter:
    """Writer of one stream for a firmware.

    strategy: whose command is written; finer: digits of coordinates and F beyond those that a
    print needs. place, offset: x, y, z, e and the user's G92 where this stream continues another;
    without a place the machine is under the user's limits. steady: see ``Timing``.
    """

    def __init__(
        self,
        strategy: str,
        rules: MotionRules,
        code: Code,
        finer: int = 0,
        place: Position | None = None,
        offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
        steady: int = 0,
    ) -> None:
        self._units = Units(finer)
        at = self._units.place(place) if place is not None else None
        self._machine = Machine(strategy, rules, code, self._units, at, offset)
        self._timing = Timing(rules, self._units, steady)
        self._lines = 0

    def write(self, chunks: Iterable[Samples]) -> Iterator[Output]:
        """Yield the text in order; ``summary`` counts what was yielded so far."""
        timed = self._timing.timed(self._machine.commands(chunks))
        for output in _joined(_as_text(timed, self._units)):
            self._lines += (output.text if isinstance(output, Deferred) else output).count(b"\n")
            yield output

    @property
    def lag(self) -> float:
        """Return the seconds by which the machine is late so far, as far as rounding tells."""
        return self._timing.lag

    @property
    def summary(self) -> GcodeSummary:
        """Return the numbers of the whole stream, once it has been written."""
        ledger, timing = self._machine.ledger, self._timing
        late = timing.lost + timing.lag
        return GcodeSummary(self._lines, ledger.busiest, ledger.written, late)


def _joined(output: Iterable[Output]) -> Iterator[Output]:
    """Yield the output with neighbouring texts joined: fewer pieces to handle."""
    text, size = list[bytes](), 0
    for piece in output:
        if isinstance(piece, bytes):
            text.append(piece)
            size += len(piece)
            if size < TEXT_AT_ONCE:
                continue
        yield b"".join(text)
        text.clear()
        size = 0
        if not isinstance(piece, bytes):
            yield piece
    yield b"".join(text)


def _as_text(commands: Iterable[TimedCommand], units: Units) -> Iterator[Output]:
    """Yield the lines of the commands. F is written where it changes."""
    feed = 0  # last F, in output units; 0: unknown
    limits = dict[bool, bytes]()  # last limit of lifts, and that of retractions
    revert = b""  # takes back what a retraction or a lift has changed
    for command in commands:
        match command:
            case Text():
                yield command.output
            case LimitChange():
                yield command.text
                feed, revert = 0, b""
                limits.clear()
            case TimedMove(move, stroke):
                if stroke.limit != limits.get(move.lifts, b""):
                    yield stroke.limit
                    limits[move.lifts] = stroke.limit
                if stroke.after and not revert:
                    yield stroke.before
                    revert = stroke.after
                feed = max(round(stroke.speed * units.per_feed), 1)  # F0 is none
                yield _standing_line(move, feed, units)
            case TimedMotion():
                yield _motion(command, feed, revert, units)
                feed, revert = int(command.feeds[-1]), b""
    yield revert


def _motion(motion: TimedMotion, feed: int, revert: bytes, units: Units) -> Output:
    """Return G1 lines from place to place, with the others. feed: F before them.

    revert: goes before the second.
    """
    between = motion.between.with_lines([(1, revert)] if revert else [], first=True)
    lines = between.table[:, : STOP + 1], between.text
    return between.deferred(*motion_lines(motion.at, motion.feeds, feed, units.decimals, *lines))


def _standing_line(move: PlacedMove, feed: int, units: Units) -> bytes:
    """Return the line of a retraction or a lift; empty where nothing moves."""
    start, end, decimals = move.start, move.end, units.decimals
    words = ["G1"]
    if end[Z] != start[Z]:
        words.append(word("Z", end[Z], decimals[Z]))
    if end[E] != start[E]:
        words.append(word("E", end[E] - start[E], decimals[E]))
    if len(words) == 1:
        return b""
    words.append(word("F", feed, decimals[-1]))
    return " ".join(words).encode() + b"\n"


@lru_cache(maxsize=1024)  # words of retractions and lifts recur
def word(letter: str, units: int, decimals: int) -> str:
    """Return one word as ``motion_lines`` writes it; for one alone, arrays take longer."""
    if abs(units) >= least_too_long(decimals):
        raise HframeError(TOO_LONG)
    return letter + plain(units / 10**decimals, decimals)
