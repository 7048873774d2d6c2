"""Moves that follow each other, gathered into one item with the lines between them."""

from __future__ import annotations

import numpy as np

from hframe_post.gcode.limits import RequestedLimits
from hframe_post.stream.types import (
    Handling,
    Item,
    Mark,
    Moves,
    Passthrough,
    Position,
    Standing,
    frozen,
)


class Gathering:
    """Rows of the moves gathered since the last item, and items that are ready in ``out``."""

    def __init__(self, limits: RequestedLimits) -> None:
        self._limits = limits
        self._start: Position = (0.0, 0.0, 0.0, 0.0)
        self._rows: list[tuple[float, ...]] = []
        self._marks: list[Mark] = []
        self.out: list[Item] = []

    def __len__(self) -> int:
        return len(self._rows)

    def travel(self, number: int, start: Position, end: Position, speed: float) -> None:
        """A move in which x or y travels joins the gathered ones, under the present limits."""
        if not self._rows:
            self._start = start
        self._rows.append((number, *end, speed, self._limits.acceleration, self._limits.corner))

    def stand(self, move: Standing) -> None:
        """A move in which x and y stand ends the gathered ones."""
        self.flush()
        self.out.append(move)

    def pass_through(self, item: Passthrough) -> None:
        """A carried line among gathered moves is a mark; all others end the gathered moves."""
        if item.handling is Handling.CARRY and self._rows:
            self._marks.append(Mark(len(self._rows), item.text))
        else:
            self.flush()
            self.out.append(item)

    def flush(self) -> None:
        """The gathered moves become one item; the axis limits are those of now."""
        if not self._rows:
            return
        table = np.array(self._rows)
        points = np.vstack([self._start, table[:, 1:5]])
        speed, acceleration, corner = (frozen(table[:, k].copy()) for k in (5, 6, 7))
        line = table[:, 0].astype(np.int64)
        self.out.append(
            Moves(
                line, frozen(points), speed, acceleration, corner, self._limits.axes,
                tuple(self._marks),
            )
        )  # fmt: skip
        self._rows, self._marks = [], []
