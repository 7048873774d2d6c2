"""Lines of G-code that need no closer look, many at once; ``gcode.reader`` reads the others.

Plain moves, limits of motion, new names of E, and lines that pass in mid-motion: comments, and
commands whose names the caller lists.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hframe_post.arrays import Array, Integers
from hframe_post.native import kernels

CELLS, CELL = 1024, 32  # of a table of names, and bytes of each
# classes of names: nothing in their lines matters; they tell the time left, or may show it; a later
# stage reads their words
HARMLESS, TELLS, SHOWS, CHANGES = 1, 2, 3, 4
APPLY, SKIP = 0.0, 1.0  # what to do with a line that limits the motion


def name_table(classes: Mapping[str, int]) -> bytes:
    """Return a table in which the loop finds the classes of names; long names are left out."""
    table = bytearray(CELLS * CELL)
    for name, number in classes.items():
        text = name.encode("latin-1", "replace")
        if len(text) > CELL - 2:
            continue
        at = 0
        for byte in text:
            at = (31 * at + byte) % (1 << 32)
        while table[CELL * (at % CELLS)]:
            at += 1
        at = CELL * (at % CELLS)
        table[at : at + len(text)] = text
        table[at + CELL - 1] = number
    return bytes(table)


def plain_lines(
    text: bytes, offset: int, first_line: int, names: bytes, words: Sequence[bytes], state: Array,
    rules: Array, rows: Array, marks: Integers, taken: Integers,
) -> int:  # fmt: skip
    """Read lines from an offset in a text on; return how many moves are among them.

    It stops before the first line that is not plain, or that needs a closer look: too far, too
    slow, off the bed, too much filament for its path, a number with many digits. The text ends
    with a line feed.

    names: see ``name_table``. words: in lower case, between bars: of comments that concern the
    reader, of those that concern later stages, and of messages that say a time. state (14,): x, y,
    z, e, mm, the offset of each from what the file calls it, feed rate, speed, mm/s, acceleration
    with and without extrusion, corner velocity, bytes that passed since the last move; it
    changes. rules (23,): mm per unit of the file, factor on the speed,
    least feed rate, greatest coordinate, greatest filament of a move, least x, y, z, greatest x, y,
    z, whether E is relative, greatest filament per mm of path, least path, greatest s of a move,
    whether moves are taken; what to do with M204, M205 and SET_VELOCITY_LIMIT; cruise ratio and
    path speed, which that must not change; most bytes that pass between moves, those counted for
    each line in addition to its own.

    rows (m, 8): become source line, x, y, z, e at the end, speed, acceleration and corner velocity
    of each move; this is negative where x and y do not change; marks (k, 4): for each line that
    passes the moves before it, where it begins and ends in the text, and its kind; taken (6,):
    lines and bytes read, marks, whether E has a new name, lines of names that set something, and
    whether the next line needs a closer look.
    """
    read = text, len(text), offset, first_line, len(rows), len(marks), names, *words
    return int(kernels.plain_lines(*read, state, rules, rows, marks, taken))
