"""Plain moves as slicers write them, many lines at once, where the compiled loop is there.

What it does with a line is what the reader does with it, to the bit. It stops before the first
line that is not a plain move in which x or y travels, or that is to be looked at with care: too
far, too slow, off the bed, too much filament for its path, a number of many digits. That line is
the reader's.
"""

from __future__ import annotations

import numpy as np

from hframe_post.gcode.batching import Gathering
from hframe_post.gcode.bed import Bed
from hframe_post.gcode.coordinates import Coordinates
from hframe_post.gcode.feed import SLOWEST, Feed
from hframe_post.gcode.lines import Lines
from hframe_post.native.kernels import kernel

FARTHEST = 1e6  # mm; a coordinate beyond is a corrupted number
MOST_FILAMENT = 2e3  # mm of one move; loading takes less
STEEPEST = 10.0  # mm of filament per mm of path; Klipper refuses more than a quarter
NO_PATH = 1e-9  # mm; a curve may end where it begins, and squares of less may be 0
_BEGINNINGS = (b"G1 ", b"G0 ")


class PlainMoves:
    """Takes the plain moves that come next in a source into what is gathered.

    ``taken``: whether there has been a move.
    """

    def __init__(
        self, source: Lines, place: Coordinates, feed: Feed, bed: Bed, items: Gathering
    ) -> None:
        self._source, self._place, self._feed, self._items = source, place, feed, items
        self._edges = (*bed.least, *bed.greatest)
        self._run = kernel("plain_moves")
        self._state, self._rules = np.empty(10), np.empty(16)
        self._rows, self._lines = np.empty((items.room, 8)), np.empty(2, dtype=np.int64)
        arrays = (self._state, self._rules, self._rows, self._lines)
        self._addresses = tuple(array.ctypes.data for array in arrays)
        self.taken = False

    def take(self) -> bool:
        """Takes some of them, up to a whole item's; whether there may be more."""
        place, feed, source = self._place, self._feed, self._source
        if self._run is None or not (place.absolute and place.e_told and all(place.known)):
            return False
        text, offset = source.text()
        if not text.startswith(_BEGINNINGS, offset):
            return False
        self._state[:] = (*place.position, *place.offset, feed.rate, feed.speed)
        self._rules[:] = (
            place.scale, feed.multiplier, SLOWEST, FARTHEST, MOST_FILAMENT, *self._edges,
            not place.absolute_e, *self._items.limits, 0.99 * STEEPEST, NO_PATH,
        )  # fmt: skip
        state, rules, rows, lines = self._addresses
        count = self._run(
            text, len(text), offset, source.number + 1, self._items.room, state, rules, rows, lines
        )
        source.skip(*self._lines.tolist())
        x, y, z, e, *_, feed.rate, feed.speed = self._state.tolist()
        if count:
            self.taken = True
            self._items.travels(place.position, self._rows[:count].copy())
            place.position = (x, y, z, e)
        return bool(self._lines[0])
