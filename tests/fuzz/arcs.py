"""Files of ten arcs, and the circles that they must follow."""

from __future__ import annotations

import math
from dataclasses import dataclass
from random import Random

ROOM = 50.0, 60.0, 220.0  # mm: the largest circle, and least and greatest x and y of the path


@dataclass(frozen=True, slots=True)
class Circle:
    """The circle of a line: mm; sweep in rad including all turns; z at start and end."""

    x: float
    y: float
    radius: float
    sweep: float
    z: tuple[float, float]


def arcs(rng: Random) -> tuple[bytes, dict[int, Circle]]:
    """Return ten consecutive arcs of any sweep, some of them helices or with several turns."""
    x, y, z = 140.0, 140.0, 0.2
    lines = [b"G28", b"G90", b"M83", b"G1 Z0.2 F600", b"G1 X%.3f Y%.3f F6000" % (x, y)]
    known: dict[int, Circle] = {}
    while len(known) < 10:
        radius = rng.choice((0.5, 2.0, 10.0, 25.0, ROOM[0])) * rng.uniform(0.5, 1.0)
        angle = rng.uniform(0.0, 2.0 * math.pi)
        I, J = round(radius * math.cos(angle), 3), round(radius * math.sin(angle), 3)
        if not all(ROOM[1] + ROOM[0] <= c <= ROOM[2] - ROOM[0] for c in (x + I, y + J)):
            radius, towards = 10.0, math.atan2(140.0 - y, 140.0 - x)
            I, J = round(radius * math.cos(towards), 3), round(radius * math.sin(towards), 3)
        cx, cy, r = x + I, y + J, math.hypot(I, J)
        sweep = rng.choice((0.01, 0.5, 1.0, 1.0, 1.999, 2.0)) * math.pi * rng.uniform(0.99, 1.0)
        full = rng.random() < 0.2
        sweep = 2.0 * math.pi if full else sweep
        clockwise = rng.random() < 0.5
        turned = math.atan2(-J, -I) + (-sweep if clockwise else sweep)
        if not full:
            x, y = round(cx + r * math.cos(turned), 3), round(cy + r * math.sin(turned), 3)
        end = b"" if full and rng.random() < 0.5 else b" X%.3f Y%.3f" % (x, y)
        by = b" I%.3f J%.3f" % (I, J)
        turns = rng.choice((0, 0, 0, 1, 2, 3))
        sweep += 2.0 * math.pi * max(turns - 1, 0)
        by += b" P%d" % turns if turns else b""
        z_before = z
        if rng.random() < 0.2:
            z = round(z + 0.3, 3)
            end += b" Z%.3f" % z
        lines.append(b"G%d%b%b E%.4f" % (2 if clockwise else 3, end, by, 0.05 * r * sweep))
        known[len(lines)] = Circle(cx, cy, r, sweep, (z_before, z))
    return b"\n".join([*lines, b";@1", b""]), known
