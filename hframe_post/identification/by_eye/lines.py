"""Lines to print for pressure advance: slow, fast and slow again, each with more of it.

Where advance is right, a line is as wide at its changes of speed as between them.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt

from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.options import Options
from hframe_post.errors import HframeError
from hframe_post.firmware.code import plain
from hframe_post.firmware.registry import firmware
from hframe_post.gcode.commands import OFF, STAMP
from hframe_post.identification.by_eye.tower import (
    COLD,
    FIRST,
    GAP,
    LAYER,
    WIDTH,
    Heat,
    extruded,
    heated,
    middle,
    travel,
)
from hframe_post.printer.settings import Printer
from hframe_post.version import __version__

COUNT, APART = 21, 4.0  # lines; mm
ENDS, MIDDLE, LONGER = 20.0, 40.0, 10.0  # mm: slow, fast; every fifth line ends so much later
SLOW, FAST = 20.0, 100.0  # mm/s


def advance_lines(printer: Printer, most: float, heat: Heat) -> list[bytes]:
    """Return the G-code of lines with advance from 0, in front, to ``most`` s.

    Raises HframeError if they do not fit onto the bed.
    """
    wide, deep = 2.0 * ENDS + MIDDLE + LONGER + 2.0 * GAP, (COUNT + 1) * APART + 2.0 * GAP
    (left, right), (front, back) = printer.travel.x, printer.travel.y
    if right - left < wide or back - front < deep:
        raise HframeError(f"the bed must be at least {wide:g} mm wide and {deep:g} mm deep")
    head = [OFF.decode(), f"; lines for pressure advance, hframe-post {__version__}"]
    pieces = ["\n".join([*head, *heated(printer, heat), ""]).encode()]
    text = (f"{line}\n".encode() for line in _lines(printer, most))
    for piece in GcodeConversion(text, printer, Options("none")):
        if isinstance(piece, bytes) and not piece.startswith(STAMP):
            pieces.append(piece)
    own = firmware(printer)
    stored = own.code(printer).set_advance(own.advance(printer).seconds)
    return [*pieces, "\n".join([stored, *COLD, ""]).encode()]


def values(most: float) -> list[float]:
    """Return the advance of each line, s, from the front one on."""
    return [round(most * k / (COUNT - 1), 5) for k in range(COUNT)]


def _lines(printer: Printer, most: float) -> Iterator[str]:
    limits, (x, y) = printer.limits, middle(printer)
    fast = min(FAST, limits.velocity, limits.flow / (LAYER * WIDTH))
    fast = max(min(fast, sqrt(0.5 * MIDDLE * limits.acceleration)), SLOW)
    left, y = x - (2.0 * ENDS + MIDDLE + LONGER) / 2.0, y - COUNT * APART / 2.0
    code = firmware(printer).code(printer)
    yield from ["G90", "M83", travel(left, y), f"G1 Z{plain(LAYER, 2)} F600"]
    yield from extruded(printer, [(left, y), (left + 2.0 * ENDS + MIDDLE, y)], FIRST)  # primes
    for k, seconds in enumerate(values(most)):
        y += APART
        end = left + 2.0 * ENDS + MIDDLE + (0.0 if k % 5 else LONGER)
        yield from [travel(left, y), code.set_advance(seconds)]
        at = left, left + ENDS, left + ENDS + MIDDLE, end
        for begin, stop, speed in zip(at, at[1:], (SLOW, fast, SLOW), strict=False):
            yield from extruded(printer, [(begin, y), (stop, y)], speed)
    yield f"G1 Z{plain(LAYER + GAP, 2)} F600"
