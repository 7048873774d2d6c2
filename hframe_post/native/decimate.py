"""Segments for Klipper: samples that stay, vertices, and what is too thick.

1. Neighbouring segments become one, those first that lose least by it, as long as every sample
   stays within the tolerance of its chord (Keogh's bottom-up segmentation, all places at once).
   A straight at constant speed becomes one segment, however long.
2. Chords lie on one side of a bend. So the vertices leave the samples for where the squares of
   what is missed are least.
"""

from __future__ import annotations

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.native import compiled, kernels


@compiled
def breakpoints(points: Array, forced: Flags, tolerance: float, /) -> Integers:
    """Return indices of the points to keep, ascending, without the first and with the last one.

    points (n + 1, 4): x, y, z, e one sample apart; forced (n + 1,): points that must stay. The
    chord of each segment is within ``tolerance`` (mm) of every sample between: of x and y
    together, of z, and of e within a fourth of it, as a mm of filament is wider than a mm of path
    is long. A segment of n > 8 samples is within √(8/n) of that, as the nozzle follows long errors.
    """


@compiled
def fitted(points: Array, ends: Integers, /) -> Array:
    """Return vertices (k, 4) at ``ends`` (k,) with the least squares of errors in x and y.

    points (n + 1, 4) as for ``breakpoints``; the first and the last stay. No vertex
    goes beyond the samples' least and greatest x and y; z and e are those of its sample.
    """


@compiled
def thinned(points: Array, ends: Integers, /) -> Integers:
    """Return ends (k,), and more, so that Klipper refuses no segment as too thick an extrusion.

    Next to a stop the command may crawl where the path does not. Klipper allows a cross section
    of 4 nozzle widths squared (``max_extrude_cross_section``), and more than that in pieces with no
    more filament than such a line as long as the nozzle is wide. The nozzle is estimated from all
    segments, as lines half as high as wide, at no more than 0.4 mm, since the flow may be high.
    """


def motion_segments(
    places: Array, ends: Integers, forced: Flags, start: Integers, still: int, per_mm: Array
) -> tuple[Integers, Integers, Array, Integers]:
    """Return places (m + 1, 4), ends (m,), seconds (m,) and dwells (m,) of segments that move.

    places (k, 4): x, y, z, e in mm, at ``ends`` (k,) of points, of which some are ``forced`` to
    separate filament; start (4,): the place before them, in units, for ``still`` samples; per_mm
    (4,): units in a mm. The dwell before a segment is in samples.
    """
    made = kernels.motion_segments(places, ends, forced, start, still, per_mm)
    at, ended, T, dwell = made
    return at[: len(T) + 1], ended, T, dwell


@compiled
def misplaced(
    points: Array, ends: Integers, rows: Integers, marked: Integers, e: Array, before: float, /
) -> Array:
    """Return the mm of filament that each of m lines has on its wrong side, (m,), or less than 0.

    points (n, 4): the path, at whose points ``ends`` (k,) segments end. rows (m,), marked (m,): the
    segment that each line precedes, and its point. e (k + 1,): filament out where segments begin
    and at the last end, mm; before: mm that the path fed before its first point.
    """
