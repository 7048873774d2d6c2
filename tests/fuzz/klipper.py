"""Some of the cases in the real Klipper host: the original file and the converted one.

Only files that Klipper plays without an error are compared.
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
from tests.fuzz.machine import Machine
from tests.klipper.host import KlippyError, Playback, play

AT_THE_END = 0.06  # mm, the tolerance where the machine is released
FILAMENT = 5e-3  # mm; a step of the extruder is 0.7e-3
ON_CIRCLE = 0.02  # mm; Klipper's path deviates by decimation (0.014) and chords
KNOWN = ("Unknown command", "M117 ", "deprecated")  # messages that do not concern motion
MOTION = re.compile(r'"[Gg]0\d')  # but this one does: G1 to the tool, unknown to Klipper


def play_both(text: bytes, output: bytes) -> str:
    """Raise AssertionError if Klipper moves differently for the output.

    Where G92 named an unknown place, the tool takes its word for where the bed is. Klipper keeps to
    where it homed, and refuses moves past that edge: such files are left out.
    """
    if Machine("klipper").play(text).named:
        return "not for Klipper"
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
        assert abs(asked - got) < AT_THE_END, f"axis {axis} ends at {got} instead of {asked}"
    asked, got = (float(p.extruded(p.end + 1.0)[0]) for p in (before, after))
    assert abs(asked - got) < FILAMENT, f"{got:.4f} mm of filament instead of {asked:.4f}"
    return "as played by Klipper"


def play_arcs(output: bytes, known: dict[int, Circle]) -> str:
    """Raise AssertionError if Klipper's path leaves the circles or lacks a part of one."""
    circles = known.values()
    with tempfile.TemporaryDirectory() as folder:
        played = _played(output, Path(folder))
    assert not _complaints(played), _complaints(played)
    at = played.position(np.arange(played.start, played.end, 2e-3))[:, :2]
    off = np.min(
        [np.abs(np.hypot(at[:, 0] - c.x, at[:, 1] - c.y) - c.radius) for c in known.values()],
        axis=0,
    )
    off = off[np.hypot(*(at - 140.0).T).argmin() :]  # from the start of the first
    assert off.max() < ON_CIRCLE, f"{off.max():.4f} mm from the nearest circle"
    moves = played.moves
    length = _lengths(moves)[np.hypot(*moves["ratio"][:, :2].T) > 0.0].sum()
    asked = sum(math.hypot(c.radius * c.sweep, c.z[1] - c.z[0]) for c in circles)
    way = math.hypot(140.0, 140.0)  # to the first of them
    assert abs(length - way - asked) < 2e-3 * asked + 0.1, (
        f"path of {length - way:.2f} mm instead of {asked:.2f}"
    )
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
