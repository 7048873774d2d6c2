"""Where a run was played, told by the run itself: how long it rests before its sweep.

The marks before and after the sweep lie equally far apart in every run, so they align any
recording with any command. The sweep between them begins later by REST for every SPACING of x, up
to a whole round of SLOTS, and a recording of another place than its command's answers the sweep
too early or too late.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import fftconvolve, hilbert

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.clock_sync import QUIETEST, band_of, marks_of
from hframe_post.identification.excitation import LONGEST_REST

SPACING = 10.0  # mm of x
SLOTS = 16
REST = 20  # samples
REACH = LONGEST_REST + 100  # samples by which a sweep's answer may be off
ALONE = 2.5 * REST  # samples of lag that no printer has
APART = 0.6  # of REST, from which an answer is not that of the command


def rest(x: float) -> int:
    """Samples of rest before the sweep at ``x`` (mm), beyond the usual."""
    return REST * (round(x / SPACING) % SLOTS)


def lag(command: Array, acceleration: Array) -> float | None:
    """Samples by which the sweep is answered later than its marks; None without marks.

    command (m,), acceleration (m,): along the swept axis.
    """
    moving = np.flatnonzero(np.abs(command) > QUIETEST * np.abs(command).max(initial=0.0))
    marks = marks_of(command, moving)
    if marks is None:
        return None
    first, last = marks.first + marks.length, marks.second
    u, a = command[first:last], acceleration[max(first - REACH, 0) : last + REACH]
    pattern = hilbert(u).conj()[::-1]
    envelope = np.abs(fftconvolve(a, pattern, "valid"))
    low, high = band_of(u, (0.05, 0.95))
    width = max(int(0.5 / (high - low) / TS), 1)  # the peak of a chirp's correlation
    smooth = fftconvolve(envelope**2, np.ones(width) / width, "same")
    return float(np.argmax(smooth) - min(REACH, first))


def check(names: Sequence[str], places: Sequence[float], lags: Sequence[float | None]) -> None:
    """Raises IdentificationError where a recording belongs to another place's command.

    The least lag is the printer's, unless it is more than any printer has.
    """
    known = [
        (name, place, late)
        for name, place, late in zip(names, places, lags, strict=True)
        if late is not None
    ]
    usual = min((late for _, _, late in known), key=abs, default=0.0)
    usual = usual if abs(usual) <= ALONE else 0.0
    allowed = APART * REST if len(known) > 1 else ALONE
    for name, place, late in known:
        off = late - usual
        if abs(off) <= allowed:
            continue
        slot = round((rest(place) + off) / REST) % SLOTS
        own = [p for _, p, _ in known if rest(p) == slot * REST]
        which = f"at x = {own[0]:g} mm" if own else "at another place"
        raise IdentificationError(
            f"{name}: by its own mark this is the recording of the sweep {which}, not of the one "
            f"at x = {place:g} mm. Are the files of two places exchanged?"
        )
