"""The place of a run, encoded in the run itself: how long it rests before its sweep.

The sweep begins later by REST for every SPACING of x, up to a whole round of SLOTS.
"""

from __future__ import annotations

SPACING = 10.0  # mm of x
SLOTS = 16
REST = 20  # samples


def rest(x: float) -> int:
    """Return the samples of extra rest before the sweep at ``x`` (mm)."""
    return REST * (round(x / SPACING) % SLOTS)
