"""What is not known of the printer, along a path: how far it may move the nozzle.

The responses say how their frequencies drift until a print and how well they are known
(``ImpulseResponse.doubts``). Both are filters of the command. Since only sums over many samples
are needed, they are computed at every EVERYth sample of the print, wherever it is cut.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Integers, X, Y
from hframe_post.model.error_range import products
from hframe_post.model.impulse_response import CoarseFilter, ImpulseResponse
from hframe_post.model.plant import Plant, Racking
from hframe_post.native.judging import sliding_sums
from hframe_post.prediction.windows import around
from hframe_post.stream.types import Samples

EVERY = 16  # samples, a power of two and a multiple of those at which errors are judged
RINGS = 3.0  # times the mean time of a squared response after which it has decayed
TINY_MM = 1e-9  # a nozzle so near to the path has no direction from it


@dataclass(frozen=True)
class _Part:
    """What is not known of one response, of an axis or of racking.

    drift, unknown: filters; None: it is known. share (k,): how the squared unknown part lasts, at
    every EVERYth sample, the latest last.
    """

    answer: int
    command: int
    racking: Racking | None
    drift: CoarseFilter | None
    unknown: CoarseFilter | None
    share: Array


class Doubts:
    """Filters for what is not known of a plant. Use ``from_plant``.

    past, ahead: samples of the command that are needed before and after a sample.
    """

    def __init__(self, parts: list[tuple[int, int, Racking | None, ImpulseResponse]]) -> None:
        self._parts = [_part(*part) for part in parts]
        filters = [f for part in self._parts for f in (part.drift, part.unknown) if f]
        self._lasting = EVERY * (max(len(part.share) for part in self._parts) - 1)
        self.past = max(f.past for f in filters) + self._lasting
        self.ahead = max(f.ahead for f in filters)

    @classmethod
    def from_plant(cls, plant: Plant, uncertainty: float | None = None) -> Doubts | None:
        """Return the doubts of a plant; None if its model counts as exact.

        uncertainty: two standard deviations of all frequencies, as a share, of responses that do
        not tell their drift.
        """
        drift = 0.5 * (uncertainty or 0.0)
        axes = [replace(G, drift=G.drift or drift) for G in (plant.Gxx, plant.Gyy)]
        parts: list[tuple[int, int, Racking | None, ImpulseResponse]] = [
            (axis, axis, None, G) for axis, G in zip((X, Y), axes, strict=True)
        ]
        if (racking := plant.racking) is not None:
            G = replace(racking.G, drift=racking.G.drift or axes[X].drift)
            parts.append((Y, X, racking, G))
        parts = [part for part in parts if part[-1].doubts]
        return cls(parts) if parts else None

    def at(self, command: Array, place: Array) -> tuple[Array, Array]:
        """Return drift (k, 2, 2) and unknown (k, 2) at every EVERYth sample.

        command (n, 2): from ``past`` samples before the first to ``ahead`` after the last of these
        samples. place (k, 2): the path there. drift: what one standard deviation of each axis
        adds to the nozzle's x and y, mm; unknown: expected squares of what is not known, mm².
        """
        count, columns = len(place), np.ascontiguousarray(command.T)
        n = EVERY * (count - 1) + 1
        drift, unknown = np.zeros((count, 2, 2)), np.zeros((count, 2))
        for part in self._parts if count else ():
            lever = 1.0 if part.racking is None else part.racking.lever(place)
            u = columns[part.command]
            if part.drift:
                drift[:, part.command, part.answer] += lever * part.drift.output(
                    u, self.past, n, EVERY
                )
            if part.unknown:
                more = EVERY * (len(part.share) - 1)
                squares = part.unknown.output(u, self.past - more, n + more, EVERY) ** 2
                lasting = sliding_sums(part.share, squares)
                unknown[:, part.answer] += np.square(lever) * lasting
        return drift, unknown

    def along(
        self, piece: Samples, commands: dict[str, Array], at: Integers, off: Array
    ) -> tuple[Integers, dict[str, Array]]:
        """Return which of the samples ``at`` (k,) of a piece were looked at, and their products.

        commands: by strategy, (n, 2) of the piece; off (k, s, 2): of each, the way from the path to
        the model's nozzle at these samples, mm. Without compensation the error is the printer's
        own, and promises nothing.
        """
        which, found = np.flatnonzero((piece.first + at) % EVERY == 0), dict[str, Array]()
        at = at[which]
        for (name, command), way in zip(commands.items(), off.transpose(1, 0, 2), strict=True):
            if name == "none" or not len(at):
                continue
            first, last = int(at[0]), int(at[-1])
            command = around(command, first - self.past, last + self.ahead + 1)
            drift, unknown = self.at(command, piece.xyze[first : last + 1 : EVERY, :2])
            rows = (at - first) // EVERY
            drift, unknown = drift.take(rows, axis=0), unknown.take(rows, axis=0)
            x, y, e = _normals(piece.xyze, at, way[which])
            d = drift[:, :, X] * x[:, None] + drift[:, :, Y] * y[:, None]
            found[name] = products(e, d, unknown[:, X] * x * x + unknown[:, Y] * y * y)
        return which, found


def _part(answer: int, command: int, racking: Racking | None, G: ImpulseResponse) -> _Part:
    drift, unknown = (
        next(map(CoarseFilter, each.doubts), None)
        for each in (replace(G, unknown=np.zeros(0)), replace(G, drift=0.0))
    )
    return _Part(answer, command, racking, drift, unknown, _lasting(G))


def _lasting(G: ImpulseResponse) -> Array:
    """Return how the unknown part of a response lasts: as long as the response itself."""
    squared = np.square(G.deviation[G.lead :])
    total = float(squared.sum())
    time = float(squared @ np.arange(len(squared))) / total if total else 0.0
    count = max(int(RINGS * time / EVERY), 1)
    share = np.exp(EVERY * np.arange(1 - count, 1) / max(time, 1.0))
    return np.asarray(share / share.sum())


def _normals(path: Array, at: Integers, off: Array) -> tuple[Array, Array, Array]:
    """Return x and y of the direction of ``off`` (k, 2), and its length, mm.

    Where that is zero, the direction is across the path.
    """
    x, y = off.T
    e = np.sqrt(x * x + y * y)
    step = path.take(at, axis=0) - path.take(np.maximum(at - 1, 0), axis=0)
    near = e < TINY_MM
    x, y = np.where(near, -step[:, Y], x), np.where(near, step[:, X], y)
    size = np.sqrt(x * x + y * y)  # the path moves there
    return x / size, y / size, e
