"""The last look at lines carried through motion: each is at its place in the filament."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, E, Integers
from hframe_post.errors import HframeError
from hframe_post.writers.stream.sample_buffer import Batch

TOLERANCE = 0.01  # mm


def check_filament(batch: Batch, ends: Integers, e: Array, still: int = 0) -> None:
    """Raises HframeError unless every carried line gets the filament that it has in the path.

    ends (k,): the points of the batch at which segments end; e (k + 1,): filament where they
    begin, and at these ends, mm; still: samples of standstill before the batch. A line stands
    before the segment that ends after its point, so what is out by then must be what the path has
    at that point, or at most a segment earlier. The first segment begins before the batch: there
    the path is taken to feed as fast as at its beginning.
    """
    if not batch.marks:
        return
    row = np.searchsorted(ends, batch.marked, side="right")
    begun = np.append(0, ends)[row]
    own = batch.points[:, E]
    path = np.append(own, 0.0)  # the last is in no range
    ranges = np.column_stack([begun, batch.marked + 1]).ravel()
    low, high = (f.reduceat(path, ranges)[::2] for f in (np.minimum, np.maximum))
    before = own[0] - still * float(np.diff(own[:2]).sum())
    low = np.where(row == 0, np.minimum(low, before), low)
    high = np.where(row == 0, np.maximum(high, before), high)
    off = np.maximum(low - e[row], e[row] - high)
    if not (off <= TOLERANCE).all():
        text = batch.marks[int(off.argmax())].text[:80].decode("latin-1")
        raise HframeError(
            f"{off.max():.4f} mm of filament would be on the wrong side of {text!r}; "
            "nothing was written. Please report this"
        )
