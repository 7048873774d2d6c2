"""What is not known of the printer, along a path: how far it may move the nozzle.

The responses say how their frequencies drift until a print and how well they are known
(``ImpulseResponse.doubts``). Both are filters of the command. Since only sums over many samples
are needed, they are computed at every EVERYth sample of the print, wherever it is cut.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Integers, X, Y
from hframe_post.model.error_range import products
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant, Racking
from hframe_post.native.judging import sliding_sums
from hframe_post.stream.types import Samples

EVERY = 16  # samples, a power of two and a multiple of those at which errors are judged
RINGS = 3.0  # times the mean time of a squared response after which it has decayed
NOWHERE = 1e-9  # mm; a nozzle so near to the path has no direction from it
TINY = 1e-300  # mm, of a path at rest


@dataclass(frozen=True)
class _Part:
    """What is not known of one response, of an axis or of racking.

    drift, unknown: reversed taps of filters of the second difference, ``late`` samples late, a
    multiple of EVERY in length, maybe none. lag: of the drift. share (k,): how the squared unknown
    part lasts, at every EVERYth sample, the latest last.
    """

    answer: int
    command: int
    racking: Racking | None
    drift: Array
    unknown: Array
    lag: float
    share: Array


class Doubts:
    """Filters for what is not known of a plant. Use ``from_plant``.

    past, ahead: samples of the command that are needed before and after a sample.
    """

    def __init__(self, parts: list[tuple[int, int, Racking | None, ImpulseResponse]]) -> None:
        filters = [doubt for *_, G in parts for doubt in G.doubts]
        late = self.ahead = max(doubt.ahead for doubt in filters)
        self._parts = [_part(*part, late) for part in parts]
        lengths = [len(taps) for part in self._parts for taps in (part.drift, part.unknown)]
        self._longest = max(lengths)
        self._lasting = max(len(part.share) for part in self._parts)
        self.past = self._longest + EVERY * self._lasting + 3

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

    def at(self, command: Array, place: Array, start: int) -> tuple[Array, Array]:
        """Return drift (k, 2, 2) and unknown (k, 2) at every EVERYth sample from ``start`` on.

        command (n, 2): from ``past`` samples before the start to ``ahead`` after the last sample.
        place (k, 2): the path at these samples. drift: what one standard deviation of each axis
        adds to the nozzle's x and y, mm; unknown: expected squares of what is not known, mm².
        """
        count = len(place)
        drift, unknown = np.zeros((count, 2, 2)), np.zeros((count, 2))
        if not count:
            return drift, unknown
        polyphase = [self._polyphase(command[:, axis], start, count) for axis in (X, Y)]
        for part in self._parts:
            lever = 1.0 if part.racking is None else part.racking.lever(place)
            phases = polyphase[part.command]
            if len(part.drift):
                added = _filtered(part.drift, phases[:, self._begin(part.drift) :])[:count]
                if part.lag:
                    k = start + EVERY * np.arange(count)
                    u = command[:, part.command]
                    added = added - part.lag * (u[k] - u[k - 1])
                drift[:, part.command, part.answer] += lever * added
            if len(part.unknown):
                first = self._begin(part.unknown) + 1 - len(part.share)
                square = np.square(_filtered(part.unknown, phases[:, first:]))
                lasting = sliding_sums(part.share, square)[:count]
                unknown[:, part.answer] += np.square(lever) * lasting
        return drift, unknown

    def _begin(self, taps: Array) -> int:
        """Return the column of ``_polyphase`` where the first output of a filter begins."""
        return self._lasting + (self._longest - len(taps)) // EVERY

    def _polyphase(self, u: Array, start: int, count: int) -> Array:
        """Return second differences (EVERY, k) column by column, for all outputs of all filters."""
        first = start + self.ahead + 1 - self._longest - EVERY * self._lasting
        n = EVERY * (count + self._lasting) + self._longest - EVERY
        return np.ascontiguousarray(np.diff(u[first - 2 : first + n], n=2).reshape(-1, EVERY).T)


def _part(
    answer: int, command: int, racking: Racking | None, G: ImpulseResponse, late: int
) -> _Part:
    of_drift = replace(G, unknown=np.zeros(0)).doubts
    of_unknown = replace(G, drift=0.0).doubts
    lag = sum(doubt.lag for doubt in of_drift)
    drift, unknown = (_taps(doubts, late) for doubts in (of_drift, of_unknown))
    return _Part(answer, command, racking, drift, unknown, lag, _lasting(G))


def _taps(doubts: Iterable[ImpulseResponse], late: int) -> Array:
    """Return the reversed taps of the first, a multiple of EVERY of them; none of none."""
    for doubt in doubts:
        taps = doubt.taps(late)
        return np.asarray(np.pad(taps, (0, -len(taps) % EVERY))[::-1])
    return np.zeros(0)


def _lasting(G: ImpulseResponse) -> Array:
    """Return how the unknown part of a response lasts: as long as the response itself."""
    squared = np.square(G.deviation[G.lead :])
    total = float(squared.sum())
    time = float(squared @ np.arange(len(squared))) / total if total else 0.0
    count = max(int(RINGS * time / EVERY), 1)
    share = np.exp(EVERY * np.arange(1 - count, 1) / max(time, 1.0))
    return np.asarray(share / share.sum())


def _filtered(taps: Array, phases: Array) -> Array:
    """Return the sums of reversed taps times the samples up to each EVERYth one."""
    by_phase = np.ascontiguousarray(taps.reshape(-1, EVERY).T)
    total = sliding_sums(by_phase[0], phases[0])
    for of_phase, row in zip(by_phase[1:], phases[1:], strict=True):
        total += sliding_sums(of_phase, row)
    return total


class JudgedDoubts:
    """The doubts along one stretch of a print, for each strategy that compensates.

    Without compensation the error is the printer's own, and promises nothing.
    """

    def __init__(self, doubts: Doubts) -> None:
        self._doubts = doubts
        self._past: dict[str, Array] = {}

    def feed(
        self, chunk: Samples, after: list[Samples], at: Integers, off: dict[str, Array]
    ) -> tuple[Integers, dict[str, Array]]:
        """Return which of the samples ``at`` (k,) were looked at, and their ``products``.

        after: what follows the chunk, at least ``ahead`` samples unless the stretch ends. off: by
        strategy, the way from the path to the model's nozzle at the samples, (k, 2), mm.
        """
        doubts = self._doubts
        which = np.flatnonzero((chunk.first + at) & (EVERY - 1) == 0)
        found = dict[str, Array]()
        compensated = {name: u for name, u in chunk.commands.items() if name != "none"}
        for name, command in compensated.items() if len(chunk) else ():
            past = self._past.get(name)
            if past is None:
                past = np.repeat(command[:1], doubts.past, axis=0)
            whole = np.concatenate(
                [past, command, *(each.commands[name] for each in after if len(each))]
            )
            self._past[name] = whole[len(command) : len(command) + doubts.past]
            found[name] = self._products(chunk, whole, at[which], off[name][which])
        return which, found

    def _products(self, chunk: Samples, command: Array, at: Integers, off: Array) -> Array:
        doubts = self._doubts
        first = -chunk.first % EVERY
        end = np.repeat(command[-1:], doubts.ahead, axis=0)
        path = chunk.xyze[first::EVERY, :2]
        drift, unknown = doubts.at(np.concatenate([command, end]), path, doubts.past + first)
        rows = (at - first) // EVERY
        normal, e = _normals(chunk, at, off)
        x, y = normal.T
        drift, unknown = drift.take(rows, axis=0), unknown.take(rows, axis=0)
        d = drift[:, :, X] * x[:, None] + drift[:, :, Y] * y[:, None]
        return products(e, d, unknown[:, X] * x * x + unknown[:, Y] * y * y)


def _normals(chunk: Samples, at: Integers, off: Array) -> tuple[Array, Array]:
    """Return the direction of ``off`` (k, 2), or across the path where it is zero, and its size."""
    e = np.sqrt(off[:, X] * off[:, X] + off[:, Y] * off[:, Y])
    step = chunk.xyze.take(at, axis=0) - chunk.xyze.take(np.maximum(at - 1, 0), axis=0)
    near = e < NOWHERE
    x, y = np.where(near, -step[:, Y], off[:, X]), np.where(near, step[:, X], off[:, Y])
    size = np.where(near, np.sqrt(x * x + y * y), e)
    return np.column_stack([x, y]) / np.maximum(size, TINY)[:, None], e
