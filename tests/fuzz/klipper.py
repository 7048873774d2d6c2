"""A share of the cases through the real Klipper host, the file as it was and as it is written.

Only files that Klipper plays without complaint are compared: what it makes of others depends on
where it stumbles.
"""

from __future__ import annotations

import math
import re
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import Array
from tests.fuzz.arcs import Circle
from tests.klipper.host import KlippyError, Playback, play

AT_THE_END = 0.06  # mm, as where the machine is released
FILAMENT = 5e-3  # mm; a step of the extruder is 0.7e-3
ON_CIRCLE = 0.02  # mm that Klipper's planned path may be off: decimation to 0.014 beside chords
KNOWN = ("Unknown command", "M117 ", "deprecated")  # complaints that say nothing of motion
MOTION = re.compile(r'"[Gg]0\d')  # but this, which is G1 to the tool and nothing to Klipper


def play_both(text: bytes, output: bytes) -> str:
    """Raises AssertionError where Klipper does something else with the output."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        try:
            before = _played(text, place / "before")
        except KlippyError:
            return "not for Klipper"
        if _complaints(before):
            return "not for Klipper"
        after = _played(output, place / "after")
    assert not _complaints(after), _complaints(after)
    for axis in range(3):
        asked, got = _end(before, axis), _end(after, axis)
        assert abs(asked - got) < AT_THE_END, f"axis {axis} ends at {got}, not at {asked}"
    asked, got = (float(p.extruded(p.end + 1.0)[0]) for p in (before, after))
    assert abs(asked - got) < FILAMENT, f"{got:.4f} mm of filament, not {asked:.4f}"
    return "as played by Klipper"


def play_arcs(output: bytes, known: dict[int, Circle]) -> str:
    """Raises AssertionError where Klipper's path is off the circles, or lacks a part of one."""
    circles = known.values()
    with tempfile.TemporaryDirectory() as folder:
        played = _played(output, Path(folder))
    assert not _complaints(played), _complaints(played)
    at = played.position(np.arange(played.start, played.end, 2e-3))[:, :2]
    off = np.min(
        [np.abs(np.hypot(at[:, 0] - c.x, at[:, 1] - c.y) - c.radius) for c in known.values()],
        axis=0,
    )
    off = off[np.hypot(*(at - 140.0).T).argmin() :]  # from where the first of them begins
    assert off.max() < ON_CIRCLE, f"{off.max():.4f} mm off every circle"
    moves = played.moves
    length = _lengths(moves)[np.hypot(*moves["ratio"][:, :2].T) > 0.0].sum()
    asked = sum(math.hypot(c.radius * c.sweep, c.z[1] - c.z[0]) for c in circles)
    way = math.hypot(140.0, 140.0)  # to the first of them
    assert abs(length - way - asked) < 2e-3 * asked + 0.1, f"{length - way:.2f} mm of {asked:.2f}"
    return "arcs as played by Klipper"


def _played(text: bytes, place: Path) -> Playback:
    place.mkdir(exist_ok=True)
    file = place / "file.gcode"
    file.write_bytes(b"G28\n" + text.removeprefix(b"\xef\xbb\xbf"))
    return play(file, workdir=place)


def _complaints(played: Playback) -> list[str]:
    return [
        line
        for line in played.warnings
        if MOTION.search(line) or not any(known in line for known in KNOWN)
    ]


def _end(played: Playback, axis: int) -> float:
    return float(played.position(played.end + 1.0)[0, axis])


def _lengths(moves: NDArray[np.void]) -> Array:
    ramps = 0.5 * moves["accel"] * (moves["accel_t"] ** 2)
    there = moves["start_v"] * moves["accel_t"] + ramps + moves["cruise_v"] * moves["cruise_t"]
    back = moves["cruise_v"] * moves["decel_t"] - 0.5 * moves["accel"] * moves["decel_t"] ** 2
    lengths: Array = there + back
    return lengths
