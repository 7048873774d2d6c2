"""A plain reading of written streams, independent of the package."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

WORD = re.compile(r"([XYZEFP])(-?\d*\.?\d+)")


@dataclass
class Reading:
    """Where a stream leads: positions of every G1, filament at every layer, other lines."""

    points: list[tuple[float, float, float]] = field(default_factory=list)
    filament: float = 0.0
    at_layer: list[float] = field(default_factory=list)
    others: list[str] = field(default_factory=list)


def follow(text: bytes) -> Reading:
    """Follows G0/G1 with G90/G91, M82/M83 and G92 E, as Klipper does."""
    reading = Reading()
    at = {"X": 0.0, "Y": 0.0, "Z": 0.0, "E": 0.0}
    absolute = absolute_e = True
    for raw in text.decode("latin-1").splitlines():
        line = raw.split(";")[0].strip()
        command = line.split()[0] if line else ""
        words = {letter: float(value) for letter, value in WORD.findall(line)}
        if command in ("G0", "G1"):
            for letter, value in words.items():
                if letter == "E":
                    step = value - at["E"] if absolute and absolute_e else value
                    reading.filament += step
                    at["E"] += step
                elif letter in "XYZ":
                    at[letter] = value if absolute else at[letter] + value
            reading.points.append((at["X"], at["Y"], at["Z"]))
            continue
        if command in ("G90", "G91"):
            absolute = command == "G90"
        elif command in ("M82", "M83"):
            absolute_e = command == "M82"
        elif command == "G92" and "E" in words:
            at["E"] = words["E"]
        if raw.startswith(";LAYER:"):
            reading.at_layer.append(reading.filament)
        reading.others.append(raw)
    return reading
