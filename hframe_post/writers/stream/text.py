"""Third pass: timed commands → lines of G-code."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from hframe_post.arrays import E, Integers, Z
from hframe_post.writers.stream import digits
from hframe_post.writers.stream.machine import Text
from hframe_post.writers.stream.pace import Settings, TimedCommand, TimedMotion, TimedMove
from hframe_post.writers.stream.print_time import Output
from hframe_post.writers.stream.segments import Units


def as_text(commands: Iterable[TimedCommand], units: Units) -> Iterator[Output]:
    """Yield the lines of the commands. F is written where it changes."""
    feed = 0  # last F, in output units; 0: unknown
    revert = b""  # takes back what a retraction or a lift has changed
    for command in commands:
        match command:
            case Text():
                yield command.output
            case Settings():
                yield command.text
                feed, revert = 0, b""
            case TimedMove():
                if command.after and not revert:
                    yield command.before
                    revert = command.after
                feed = command.feed
                yield standing_line(command, units)
            case TimedMotion():
                yield from _motion(command, feed, Text(revert), units)
                feed, revert = int(command.feeds[-1]), b""
    yield revert


def _motion(motion: TimedMotion, feed: int, revert: Text, units: Units) -> Iterator[Output]:
    """Yield the rows of the segments with the lines between them."""
    rows, ends = _rows(motion.at, motion.feeds, feed, units)
    between = sorted([(1, revert), *motion.between], key=lambda item: item[0])
    written = 0
    for row, text in between:
        end = int(ends[row - 1]) if row else 0
        if end > written:
            yield rows[written:end]
            written = end
        yield text.output
    yield rows[written:]


def _rows(at: Integers, feeds: Integers, feed: int, units: Units) -> tuple[bytes, Integers]:
    """Return G1 lines from place to place, at (k + 1, 4), and where each ends in their text.

    feeds (k,): F of each; feed: F before them.
    """
    shown = np.diff(at, axis=0) != 0
    shown[0, :Z] |= feed == 0  # after the machine was released: both, to be plain
    changed = np.diff(feeds, prepend=feed) != 0
    values = np.vstack([at[1:, :E].T, np.diff(at[:, E]), feeds])
    decimals = (*units.decimals, units.feed_decimals)
    return digits.command_lines(b"G1", b"XYZEF", values, decimals, np.vstack([shown.T, changed]))


def standing_line(move: TimedMove, units: Units) -> bytes:
    """Return the line of a retraction or a lift; empty where nothing moves."""
    dz, de = int(move.end[Z] - move.start[Z]), int(move.end[E] - move.start[E])
    if not (dz or de):
        return b""
    values = np.array([[move.end[Z]], [de], [move.feed]])
    decimals = (units.decimals[Z], units.decimals[E], units.feed_decimals)
    shown = np.array([[dz != 0], [de != 0], [True]])
    return digits.command_lines(b"G1", b"ZEF", values, decimals, shown)[0]
