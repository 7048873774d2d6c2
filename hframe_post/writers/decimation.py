"""Samples in batches, and the segments that a firmware makes of them, in output units."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hframe_post.arrays import Array, E, Flags, Integers, X, Y
from hframe_post.errors import HframeError
from hframe_post.firmware.motion import DECIMALS, MotionRules
from hframe_post.native.decimate import misplaced, motion_segments
from hframe_post.stream.marks import NO_MARKS, Marks
from hframe_post.stream.types import Position

SAMPLES_AT_ONCE = 1 << 14
FILAMENT_SLACK_MM = 0.01  # mm on the wrong side of a line

Place = tuple[int, int, int, int]  # x, y, z, e in output units


@dataclass(frozen=True)
class Units:
    """How finely a place (x, y, z, e) and F are written.

    finer: digits of x, y, z and F beyond those of a print: 0.001 mm, 0.1 mm/min; e: 0.00001 mm.
    """

    finer: int = 0

    @cached_property
    def decimals(self) -> tuple[int, ...]:
        """Return the decimals of x, y, z, e in mm and of F in mm/min."""
        return *(DECIMALS + self.finer,) * 3, 5, 1 + self.finer

    @cached_property
    def per_mm(self) -> Array:
        """Return the units in a mm of x, y, z, e (4,)."""
        return np.array([float(10**places) for places in self.decimals[:-1]])

    @cached_property
    def per_feed(self) -> float:
        """Return the units of F in a mm/s."""
        return 60.0 * float(10 ** self.decimals[-1])

    def rounded(self, places: Array) -> Integers:
        """Return places (..., 4) in mm as they are written, in units."""
        return np.rint(places * self.per_mm).astype(np.int64)

    def place(self, at: Position) -> Place:
        """Return one place in mm as it is written."""
        xy, e = self._scale
        return round(at[0] * xy), round(at[1] * xy), round(at[2] * xy), round(at[3] * e)

    def mm(self, place: Place) -> Position:
        """Return a place in mm."""
        xy, e = self._scale
        return place[0] / xy, place[1] / xy, place[2] / xy, place[3] / e

    @cached_property
    def _scale(self) -> tuple[float, float]:
        """Return the units in a mm of x, y and z, and of e."""
        xy, *_, e = self.per_mm.tolist()
        return xy, e


class Batch(NamedTuple):
    """Samples (n,) that are written together.

    first: index of the first; points (n + 1, 4): x, y, z, e in mm, beginning where the machine
    is before them; marks: the lines that pass before one of them; last: motion ends here.
    """

    first: int
    points: Array
    marks: Marks
    last: bool

    @property
    def samples(self) -> int:
        return len(self.points) - 1

    @property
    def marked(self) -> Integers:
        """Return the point of each mark."""
        return self.marks.at - self.first + 1

    @property
    def forced(self) -> Flags:
        """Return the points (n + 1,) at which a line of the file passes."""
        forced = np.zeros(len(self.points), dtype=bool)
        if self.marks:
            forced[self.marked] = True
        return forced


class SampleBuffer:
    """Contiguous samples, at most SAMPLES_AT_ONCE, and the lines between them, taken in order.

    The points of a batch are those of the buffer: use the batch up before you add samples.
    """

    def __init__(self) -> None:
        self._points = np.empty((1 + SAMPLES_AT_ONCE, 4))  # the first precedes the samples
        self._count = 0
        self._before: Array | None = None  # the sample before the first, in the midst of motion
        self._index = 0  # of the first, or of the next to come
        self._marks = list[Marks]()

    def __len__(self) -> int:
        return self._count

    def add(self, xy: Array, xyze: Array, advance: Array | None, index: int, here: Position) -> int:
        """Add samples from ``index`` on, and return how many there was room for.

        xy (n, 2): the command; xyze (n, 4): the path, for z and e; advance (n,): mm to add to e;
        here: the machine's place before them if motion begins.
        """
        if not self._count:
            self._index = index
            self._points[0] = here if self._before is None else self._before
        first = 1 + self._count
        n = min(len(xy), SAMPLES_AT_ONCE - self._count)
        points = self._points[first : first + n]
        points[:] = xyze[:n]  # rows, then columns: numpy is slow along axes as short as two
        points[:, X] = xy[:n, X]
        points[:, Y] = xy[:n, Y]
        if advance is not None:
            points[:, E] += advance[:n]
        self._count += n
        return n

    def add_marks(self, marks: Marks) -> None:
        """Add lines that pass before their samples, which may follow later."""
        self._marks.append(marks)

    def resume(self, place: Position) -> None:
        """Go on from a place, mm, at the next sample; the buffer is empty."""
        self._before = np.array(place)

    def batch(self, last: bool) -> Batch | None:
        """Remove and return the samples; None if there are none. last: motion ends there."""
        if not self._count:
            return None
        first, points = self._index, self._points[: 1 + self._count]
        self._index += self._count
        self._count, self._before = 0, None if last else points[-1].copy()
        return Batch(first, points, self.marks_up_to(self._index - 1), last)

    def marks_up_to(self, index: int | None = None) -> Marks:
        """Remove and return the lines up to a sample, or up to the first that is buffered."""
        if not self._marks:
            return NO_MARKS
        marks, index = Marks.joined(self._marks), self._index if index is None else index
        count = marks.count_before(index + 1)
        self._marks = [marks.rows(count)] if count < len(marks) else []
        return marks.rows(0, count)


class Segments(NamedTuple):
    """Segments (k,) in which something moves, and the dwells around them.

    at (k + 1, 4): places, in output units; ends (k,): the point of the batch at which each ends;
    T (k,): how long it is to last, s; dwell (k,): samples of dwell before it; still: samples
    of dwell after the last.
    """

    at: Integers
    ends: Integers
    T: Array
    dwell: Integers
    still: int


def segments(batch: Batch, start: Place, still: int, rules: MotionRules, units: Units) -> Segments:
    """Return the segments of a batch that its firmware asks for.

    start: where the machine is; still: for how many samples it has. A segment that moves
    nothing, when rounded, takes no line: its time joins the next segment, or is a dwell.
    """
    forced = batch.forced
    made, places = rules.segments(batch.points, forced, batch.last)
    at, ends, T, dwell = motion_segments(places, made, forced, np.array(start), still, units.per_mm)
    left = batch.samples - int(ends[-1]) if len(ends) else still + batch.samples
    return Segments(at, ends, T, dwell, left)


def rows_before(batch: Batch, ends: Integers) -> Integers:
    """Return for each line of the file the segment that it precedes.

    ends (k,): the points of the batch at which segments end. A line is written before the segment
    that ends after its point.
    """
    return ends.searchsorted(batch.marked, "right")


def check_filament(batch: Batch, ends: Integers, e: Array, still: int = 0) -> None:
    """Raise HframeError unless the filament at every line of the file is that of the path.

    ends (k,): see ``rows_before``; e (k + 1,): filament where segments begin, and at these ends,
    mm; still: samples of dwell before the batch. The filament out by a line must be what the
    path has at its point, or at most a segment earlier. The first segment begins before the batch:
    there the path is taken to feed as fast as at its beginning.
    """
    rows = rows_before(batch, ends)
    before = still * (batch.points[1, E] - batch.points[0, E])
    off = misplaced(batch.points, ends, rows, batch.marked, e, before)
    if not (off <= FILAMENT_SLACK_MM).all():
        k = int(np.argmin(off <= FILAMENT_SLACK_MM))
        text = next(iter(batch.marks.rows(k))).text[:80].decode("latin-1")
        raise HframeError(
            f"{off[k]:.4f} mm of filament would be on the wrong side of {text!r}; "
            "nothing was written. Please report this"
        )
