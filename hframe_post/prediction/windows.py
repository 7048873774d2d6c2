"""Windows of a print, each with what comes before and after it, so that it can be judged alone.

A prediction costs little if some of them stand for all. The beginning of a print is judged whole,
then one of SOME windows, after four minutes one of FEW. Errors of a window that stands for others
count as often. On five slices the RMS was within 5 % of that of all samples. Windows lie on a grid
of samples, wherever the stream is cut.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, E
from hframe_post.stream.chunks import join, part
from hframe_post.stream.types import Samples

WINDOW = 4096  # samples; before each, about 1000 more lead the filters into their state
ALIKE = 8  # windows that follow each other and count alike are taken together: 5 % of a page's CPU
SOME, FEW = 8, 32  # windows of which the one in the middle is judged
WHOLE = 16 * WINDOW  # samples of a print's beginning, 66 s, that are all judged
BEGINNING = 4  # times as many samples, of which SOME windows are


@dataclass(frozen=True, slots=True)
class Window:
    """Samples start … stop − 1 of a piece, which has others before and after them.

    weight: of how many windows it is an example; 0: another one is an example of it. filament: at
    the stretch's first sample, mm.
    """

    piece: Samples
    start: int
    stop: int
    weight: int
    filament: float


class Windows:
    """Cuts windows out of a stream that passes.

    before, after: samples that a window needs around it. whole: samples from the first one on that
    are all judged; None: all of the print. shown: those that have an example are needed, too.
    """

    def __init__(
        self, before: int, after: int, whole: int | None = None, shown: bool = False
    ) -> None:
        self._before, self._after, self._whole, self._shown = before, after, whole, shown
        self._kept, self._start, self._filament = list[Samples](), -1, 0.0

    def of(self, chunks: Iterable[Samples]) -> Iterator[Window]:
        """Yield all windows of a stream."""
        for chunk in chunks:
            yield from self.take(chunk)
        yield from self.end()

    def take(self, chunk: Samples) -> Iterator[Window]:
        """Yield the windows that are complete with the next chunk."""
        if self._kept and not (len(self._kept[-1]) and len(chunk)):  # one may have events alone
            last = self._kept.pop()
            events = last.events + chunk.events
            both = chunk if len(chunk) else last
            chunk = replace(both, events=events, ends_stretch=chunk.ends_stretch)
        self._kept.append(chunk)
        if self._start < 0 and len(chunk):
            self._start, self._filament = chunk.first, float(chunk.xyze[0, E])
        yield from self._complete(chunk.ends_stretch)

    def end(self) -> Iterator[Window]:
        """Yield what is left at the end of the stream."""
        yield from self._complete(ended=True)

    def _complete(self, ended: bool) -> Iterator[Window]:
        end = self._kept[-1].end if self._kept else -1
        if ended and self._kept and self._start < 0:  # there may be events
            yield Window(self._kept[-1], 0, 0, 1, 0.0)
        while 0 <= self._start < end:
            stop, weight = self._stop(self._start)
            if weight or self._shown:
                if end < stop + self._after and not ended:
                    break
                yield self._window(min(stop, end), weight)
            self._start = stop
        if ended:
            self._kept, self._start = [], -1
        elif self._start >= 0:
            self._kept = [each for each in self._kept if each.end > self._start - self._before]

    def _stop(self, start: int) -> tuple[int, int]:
        """Return where the window ends that begins at a sample, and its weight."""
        k = start // WINDOW
        weight = self._weight(k)
        k += 1
        while k % ALIKE and self._weight(k) == weight <= 1:
            k += 1
        return k * WINDOW, weight

    def _weight(self, k: int) -> int:
        if self._whole is None or k * WINDOW < self._whole:
            return 1
        every = SOME if k * WINDOW < BEGINNING * self._whole else FEW
        return every if k % every == every // 2 else 0

    def _window(self, stop: int, weight: int) -> Window:
        low, high = self._start - self._before, stop + self._after
        piece = join([
            part(each, max(low - each.first, 0), min(high, each.end) - each.first)
            for each in self._kept if low < each.end and each.first < high
        ])  # fmt: skip
        start = self._start - piece.first
        return Window(piece, start, stop - piece.first, weight, self._filament)


def around(rows: Array, low: int, high: int) -> Array:
    """Return rows low … high − 1; before the first and after the last row are those themselves."""
    if low >= 0 and high <= len(rows):
        return rows[low:high]
    return np.take(rows, np.arange(low, high), axis=0, mode="clip")
