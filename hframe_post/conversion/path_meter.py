"""What becomes of the file's path: how much is not compensated and why, what held it back."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hframe_post.arrays import Array, E, Flags, lengths
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import Item, Moves, Passthrough

MOST_CAUSES = 200  # told apart; the others are one
OTHERS = "others"
SHOWN = 4  # causes in the text
TELLING = 0.005  # share of the extrusion that must not be overlooked


@dataclass
class Uncompensated:
    """Moves that pass as they stand: how many, their path and filament, mm."""

    moves: int = 0
    path: float = 0.0
    filament: float = 0.0


@dataclass
class HeldBack:
    """Path (mm) on which one side's limit is lower than what the other asks; least, greatest."""

    path: float = 0.0
    least: float = math.inf
    greatest: float = 0.0

    def add(self, where: Flags, path: Array, limit: Array) -> None:
        """Takes moves (n,), of which those ``where`` are held back to ``limit``."""
        if where.any():
            self.path += float(path[where].sum())
            self.least = min(self.least, float(limit[where].min()))
            self.greatest = max(self.greatest, float(limit[where].max()))


@dataclass
class PathSummary:
    """Path and filament of all that travels, mm; what passed as it stood, by its cause.

    acceleration, corner: held back by the file, or what is said ``by``, mm/s² and mm/s; speed:
    by the profile, mm/s.
    """

    path: float = 0.0
    filament: float = 0.0
    uncompensated: dict[str, Uncompensated] = field(default_factory=dict)
    acceleration: HeldBack = field(default_factory=HeldBack)
    corner: HeldBack = field(default_factory=HeldBack)
    speed: HeldBack = field(default_factory=HeldBack)
    by: str = "the file"

    @property
    def path_share(self) -> float:
        """Of the path, that is not compensated."""
        path = sum(part.path for part in self.uncompensated.values())
        return path / self.path if self.path else 0.0

    @property
    def extrusion_share(self) -> float:
        """Of the filament laid while the nozzle travels, that is not compensated."""
        filament = sum(part.filament for part in self.uncompensated.values())
        return filament / self.filament if self.filament else 0.0

    def as_json(self) -> dict[str, Any]:
        """Everything, ready for ``json.dumps``."""
        held = {"acceleration": self.acceleration, "corner": self.corner, "speed": self.speed}
        return {
            "uncompensated": {
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
            },
            "held_back": {
                name: {
                    "path_percent": round(100.0 * each.path / self.path, 2),
                    "least": round(each.least, 3),
                    "greatest": round(each.greatest, 3),
                }
                for name, each in held.items()
                if each.path
            },
        }

    def as_text(self) -> list[str]:
        """A line or two for a person."""
        lines = []
        if self.uncompensated:
            parts = [f"{cause} {self._percent(part.path)}" for cause, part in self._largest()]
            more = f" and {len(parts) - SHOWN} more" if len(parts) > SHOWN else ""
            lines.append(
                f"as it was   {100.0 * self.path_share:.2f} % of the path, "
                f"{100.0 * self.extrusion_share:.2f} % of the extrusion, where a command may have "
                f"moved the head: {', '.join(parts[:SHOWN])}{more}"
            )
        held = []
        if self.acceleration.path:
            a = self.acceleration
            held.append(f"acceleration by {self.by} ({_range(a)} mm/s², {self._percent(a.path)})")
        if self.corner.path:
            c = self.corner
            held.append(f"corners by {self.by} ({_range(c)} mm/s, {self._percent(c.path)})")
        if self.speed.path:
            v = self.speed
            held.append(f"speed by the profile ({_range(v)} mm/s, {self._percent(v.path)})")
        if held:
            lines.append(f"held back   {'; '.join(held)}")
        return lines

    def warnings(self) -> list[str]:
        """What a person must not overlook."""
        if self.extrusion_share <= TELLING:
            return []
        cause = max(self.uncompensated.items(), key=lambda item: item[1].filament)[0]
        percent = 100.0 * self.extrusion_share
        return [
            f"AS IT WAS   {percent:.1f} % of the extrusion is not compensated, "
            f"mostly after {cause}: if that does not move the head, name it under harmless in "
            "[firmware] of the profile; if it comes back, under returns"
        ]

    def _largest(self) -> list[tuple[str, Uncompensated]]:
        return sorted(self.uncompensated.items(), key=lambda item: -item[1].path)

    def _percent(self, path: float) -> str:
        percent = 100.0 * path / self.path if self.path else 0.0
        return f"{percent:.0f} %" if percent >= 10.0 else f"{percent:.2g} %"


def _range(held: HeldBack) -> str:
    low, high = f"{held.least:.4g}", f"{held.greatest:.4g}"
    return low if low == high else f"{low} to {high}"


class PathMeter:
    """Measures the path, and compares the file's limits with the profile's."""

    def __init__(self, limits: Limits, paced: bool = False) -> None:
        self._limits = limits
        self.summary = PathSummary(by="the error allowed" if paced else "the file")

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        """What the reader made of the file."""
        for item in items:
            if isinstance(item, Moves):
                self._travel(item)
            elif isinstance(item, Passthrough) and item.cause:
                self._as_it_stood(item)
            yield item

    def _travel(self, moves: Moves) -> None:
        limits, summary = self._limits, self.summary
        delta = np.diff(moves.points, axis=0)
        path = lengths(delta[:, :E])
        summary.path += float(path.sum())
        summary.filament += float(np.maximum(delta[:, E], 0.0).sum())
        share = np.abs(delta[:, :E]) / path[:, None]
        with np.errstate(divide="ignore"):
            by_axis = (np.array(moves.limits.acceleration[:E]) / share).min(axis=1)
        acceleration = np.minimum(moves.acceleration, by_axis)
        summary.acceleration.add(acceleration < limits.acceleration, path, acceleration)
        corner = limits.square_corner_velocity
        summary.corner.add(moves.corner < corner, path, moves.corner)
        velocity = np.full(len(path), limits.velocity)
        summary.speed.add(moves.speed > limits.velocity, path, velocity)

    def _as_it_stood(self, move: Passthrough) -> None:
        causes = self.summary.uncompensated
        known = move.cause in causes or len(causes) < MOST_CAUSES
        part = causes.setdefault(move.cause if known else OTHERS, Uncompensated())
        part.moves += 1
        part.path += move.path
        self.summary.path += move.path
        if move.path:
            part.filament += max(move.filament, 0.0)
            self.summary.filament += max(move.filament, 0.0)
