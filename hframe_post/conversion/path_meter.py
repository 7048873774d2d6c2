"""A file's path: its length, what of it is not compensated, and what slows it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hframe_post.arrays import Array, E, Flags, lengths
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import Item, Moves, Passthrough

MEASURED_TOGETHER = 4096  # moves


@dataclass
class Uncompensated:
    """Moves that are not compensated for one reason: their number, path and filament in mm."""

    moves: int = 0
    path: float = 0.0
    filament: float = 0.0


@dataclass
class Limited:
    """Path (mm) on which one limit is lower than another, and the range of that limit."""

    path: float = 0.0
    least: float = math.inf
    greatest: float = 0.0

    def add(self, where: Flags, path: Array, limit: Array) -> None:
        """Add the moves ``where`` (n,) it applies: their path (n,) and their limit (n,)."""
        if where.any():
            self.path += float(path[where].sum())
            self.least = min(self.least, float(limit[where].min()))
            self.greatest = max(self.greatest, float(limit[where].max()))


@dataclass
class PathSummary:
    """Path and filament of all travel (mm), what is not compensated, and what limits the speed.

    acceleration (mm/s²) and corner (mm/s): limited by the file, or by the pace that was set for an
    allowed error (paced); speed (mm/s): limited by the profile.
    """

    path: float = 0.0
    filament: float = 0.0
    uncompensated: dict[str, Uncompensated] = field(default_factory=dict)
    acceleration: Limited = field(default_factory=Limited)
    corner: Limited = field(default_factory=Limited)
    speed: Limited = field(default_factory=Limited)
    paced: bool = False

    @property
    def path_share(self) -> float:
        """Return the share of the path that is not compensated."""
        path = sum(part.path for part in self.uncompensated.values())
        return path / self.path if self.path else 0.0

    @property
    def extrusion_share(self) -> float:
        """Return the share of the filament, laid while travelling, that is not compensated."""
        filament = sum(part.filament for part in self.uncompensated.values())
        return filament / self.filament if self.filament else 0.0

    def uncompensated_as_text(self) -> str:
        """Return how much is not compensated, and after which commands."""
        if not self.uncompensated:
            return "nothing: the whole path is"
        causes = [cause for cause, _ in self._largest()]
        more = f" and {len(causes) - 4} more" if len(causes) > 4 else ""
        return (
            f"{percent(self.path_share)} of the path, {percent(self.extrusion_share)} of the "
            f"extrusion (after {', '.join(causes[:4])}{more})"
        )

    def limits_as_json(self) -> dict[str, Any]:
        """Return where limits apply, and their ranges."""
        limits = {"acceleration": self.acceleration, "corner": self.corner, "speed": self.speed}
        return {
            name: {
                "path_percent": round(100.0 * limit.path / self.path, 2),
                "least": round(limit.least, 3),
                "greatest": round(limit.greatest, 3),
            }
            for name, limit in limits.items()
            if limit.path
        }

    def uncompensated_as_json(self) -> dict[str, Any]:
        """Return what is not compensated, by cause, the longest path first."""
        return {
            "path_percent": round(100.0 * self.path_share, 3),
            "extrusion_percent": round(100.0 * self.extrusion_share, 3),
            "by_cause": {
                cause: {
                    "moves": part.moves,
                    "path_mm": round(part.path, 3),
                    "filament_mm": round(part.filament, 5),
                }
                for cause, part in self._largest()
            },
        }

    def _largest(self) -> list[tuple[str, Uncompensated]]:
        """Return causes of uncompensated motion, the longest path first."""
        return sorted(self.uncompensated.items(), key=lambda item: -item[1].path)


def percent(share: float) -> str:
    """Return a share as text: whole from 10 % on, below with two digits."""
    value = 100.0 * share
    return f"{value:.0f} %" if value >= 10.0 else f"{value:.2g} %"


class PathMeter:
    """Measures the path, and compares the limits of its moves with the profile's."""

    def __init__(self, limits: Limits, paced: bool = False) -> None:
        self._limits = limits
        self._summary = PathSummary(paced=paced)
        self._waiting: list[Moves] = []
        self._count = 0  # of moves that wait to be measured together

    @property
    def summary(self) -> PathSummary:
        """Return what is known of the items so far."""
        self._measure()
        return self._summary

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        for item in items:
            if isinstance(item, Moves):
                self._waiting.append(item)
                self._count += len(item.line)
                if self._count >= MEASURED_TOGETHER:
                    self._measure()
            elif isinstance(item, Passthrough) and item.cause:
                self._add_uncompensated(item)
            yield item

    def _measure(self) -> None:
        if not self._waiting:
            return
        limits, summary, waiting = self._limits, self._summary, self._waiting
        delta = np.concatenate([moves.points[1:] - moves.points[:-1] for moves in waiting])
        path = lengths(delta[:, :E])
        summary.path += float(path.sum())
        summary.filament += float(np.maximum(delta[:, E], 0.0).sum())
        speed, acceleration, corner = (
            np.concatenate([getattr(moves, name) for moves in waiting])
            for name in ("speed", "acceleration", "corner")
        )
        end = 0
        for moves in waiting:
            of = slice(end, end := end + len(moves.line))
            moves.limits.lower(speed[of].copy(), acceleration[of], moves.points)
        summary.acceleration.add(acceleration < limits.acceleration, path, acceleration)
        summary.corner.add(corner < limits.square_corner_velocity, path, corner)
        velocity = np.full(len(path), limits.velocity)
        summary.speed.add(speed > limits.velocity, path, velocity)
        self._waiting, self._count = [], 0

    def _add_uncompensated(self, move: Passthrough) -> None:
        causes = self._summary.uncompensated
        known = move.cause in causes or len(causes) < 200  # bounds the memory of odd files
        part = causes.setdefault(move.cause if known else "others", Uncompensated())
        part.moves += 1
        part.path += move.path
        self._summary.path += move.path
        if move.path:
            part.filament += max(move.filament, 0.0)
            self._summary.filament += max(move.filament, 0.0)
