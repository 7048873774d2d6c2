"""Reading of many plain moves at once; ``gcode.reader`` reads other lines one by one."""

from __future__ import annotations

from hframe_post.arrays import Array, Integers
from hframe_post.native import kernels


def plain_moves(
    text: bytes, offset: int, first_line: int, most: int, state: Array, rules: Array, rows: Array,
    taken: Integers,
) -> int:  # fmt: skip
    """Read at most ``most`` moves from an offset in a text on; return how many.

    It stops before the first line that is not a plain G0 or G1 in which x or y changes, or that
    needs a closer look. The text ends with a line feed. state (10,):
    x, y, z, e, mm, the offset of each from what the file calls it, feed rate, speed, mm/s; it
    changes. rules (16,): mm per unit of the file, factor on the speed, least feed rate, greatest
    coordinate, greatest filament of a move, least x, y, z, greatest x, y, z, whether E is relative,
    acceleration, corner velocity, greatest filament per mm of path, least path. rows (most, 8):
    become source line, x, y, z, e at the end, speed, acceleration and corner velocity of each move;
    taken (2,): the lines and bytes read.
    """
    read = text, len(text), offset, first_line, most
    return int(kernels.plain_moves(*read, state, rules, rows, taken))
