"""Segments for Klipper: few of them, and none that it would refuse."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers
from hframe_post.native.decimate import breakpoints, too_thick

PIECE = 250  # samples, within which the bound on lines is kept
COARSER = 1.2  # times the tolerance, until a second has few enough segments


def thinned(points: Array, ends: Integers) -> Integers:
    """Return ends (k,), and more, so that Klipper refuses no segment as too thick an extrusion.

    Next to a stop the command may crawl where the path does not. Klipper allows a cross section
    of 4 nozzle widths squared (``max_extrude_cross_section``), and more than that in pieces with no
    more filament than such a line as long as the nozzle is wide.
    """
    thick, most = too_thick(points, ends)
    if not len(thick):
        return ends
    pieces = [ends]
    for k in thick.tolist():  # few
        first, end = int(ends[k - 1]) if k else 0, int(ends[k])
        piece = np.floor((points[first:end, E] - points[first, E]) / most)
        pieces.append(first + 1 + np.flatnonzero(np.diff(piece[1:])))
    return np.unique(np.concatenate(pieces))


def sparser(
    points: Array, forced: Flags, tolerance: float, ends: Integers, rate: float
) -> Integers:
    """Return the breakpoints ``ends``, fewer wherever a second has more than ``rate`` of them.

    points, forced, tolerance: as for ``breakpoints``. In such a second the tolerance grows.
    """
    fewer = []
    for first in range(0, len(points) - 1, PIECE):
        last = min(first + PIECE, len(points) - 1)
        kept, allowed = ends[(ends > first) & (ends <= last)], rate * (last - first) * TS
        allowed = max(allowed, 1.0 + np.count_nonzero(forced[first + 1 : last]))
        coarse = tolerance
        while len(kept) > allowed:
            coarse *= COARSER
            kept = first + breakpoints(points[first : last + 1], forced[first : last + 1], coarse)
        if coarse > tolerance and first:
            fewer.append(np.array([first]))
        fewer.append(kept)
    return np.unique(np.concatenate(fewer))
