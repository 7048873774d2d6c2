"""Lines of G-code that need no closer look, many at once; ``gcode.reader`` reads the others.

Plain moves, limits of motion, new names of E, and lines that pass in mid-motion: comments, and
commands whose names the caller lists.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from hashlib import blake2b

from hframe_post.arrays import Array, Integers
from hframe_post.native import kernels

CELLS, CELL = 1024, 128  # of a table of names and lines, and bytes of each
NUMBER_BYTES = 8  # of the number that a cell ends with
# classes of names: their lines need a closer look; nothing in them matters; they tell the time
# left, or may show it; they set a mode that is set; a later stage reads their words; they label
# objects
UNKNOWN, HARMLESS, TELLS, SHOWS, MODES, CHANGES, LABELS = range(7)
APPLY, SKIP = 0.0, 1.0  # what to do with a line that limits the motion


class Known:
    """What the loop knows: the classes of names, and lines that were read before, by their text.

    Long ones are left out. There is room for CELLS / 2 texts; then the lines are forgotten.
    """

    def __init__(self, classes: Mapping[str, int]) -> None:
        self._classes = dict(classes)
        self.forget()

    def forget(self) -> None:
        """Forget the lines."""
        self.table, self._count = bytearray(CELLS * CELL), 0
        for name, number in self._classes.items():
            self._add(name.encode("latin-1", "replace"), number)

    def classify(self, classes: Mapping[str, int]) -> None:
        """Change the classes of names."""
        if not classes.items() <= self._classes.items():
            self._classes.update(classes)
            for name, number in classes.items():
                self._add(name.encode(), number)

    def learn(self, line: bytes, number: int) -> None:
        """Note the number of a line, a ``digest``: of the object that it names, or what it sets."""
        if self._count >= CELLS // 2:
            self.forget()
        self._add(line + b"\n", number)

    def _add(self, text: bytes, number: int) -> None:
        if not text or len(text) >= CELL - NUMBER_BYTES or b"\0" in text:
            return
        table, at = self.table, 0
        for byte in text:
            at = (31 * at + byte) % (1 << 32)
        key = text + b"\0"
        while table[begin := CELL * (at % CELLS)]:
            if table[begin : begin + len(key)] == key:
                break
            at += 1
        else:
            if self._count >= CELLS // 2:
                return
            table[begin : begin + len(text)] = text
            self._count += 1
        table[begin + CELL - NUMBER_BYTES : begin + CELL] = number.to_bytes(8, sys.byteorder)


def digest(text: bytes) -> int:
    """Return a number that a float holds and that no other text of a file has; 0 for none."""
    return int.from_bytes(blake2b(text, digest_size=6).digest()) if text else 0


def plain_lines(
    text: bytes, offset: int, first_line: int, known: Known, words: Sequence[bytes], state: Array,
    rules: Array, rows: Array, marks: Integers, taken: Integers,
) -> int:  # fmt: skip
    """Read lines from an offset in a text on; return how many moves are among them.

    It stops before the first line that is not plain, or that needs a closer look: too far, too
    slow, off the bed, too much filament for its path, a number with many digits. It also stops
    before a move for which cruise ratio or path speed are others. The text ends with a line feed.

    words: in lower case, between bars: of comments that concern the reader unless it knows them, of
    those that name a place, and of comments and messages that say a time. state (19,): x, y, z, e,
    mm, the offset of each from what the file calls it, feed rate, speed, mm/s, acceleration with
    and without extrusion, corner velocity, bytes that passed since the last move, the object that
    is printed, that of the last move in x or y, the line that set something last, -1: not known,
    cruise ratio, path speed; it changes. rules (22,): mm per unit of the file, factor on the speed,
    least feed rate, greatest coordinate, greatest filament of a move, least x, y, z, greatest x, y,
    z, whether E is relative, greatest filament per mm of path, least path, greatest s of a move,
    whether moves are taken; what to do with M204, M205 and SET_VELOCITY_LIMIT; most bytes that pass
    between moves, those counted for each line in addition to its own; whether there may be several
    objects, so that the first move in x or y after one needs a closer look.

    rows (m, 8): become source line, x, y, z, e at the end, speed, acceleration and corner velocity
    of each move; this is negative where x and y do not change; marks (k, 4): for each line that
    passes the moves before it, where it begins and ends in the text, and its kind; taken (6,):
    lines and bytes read, marks, whether E has a new name, lines of names that set something, and
    whether the next line needs a closer look.
    """
    read = text, len(text), offset, first_line, len(rows), len(marks), known.table, *words
    return int(kernels.plain_lines(*read, state, rules, rows, marks, taken))
