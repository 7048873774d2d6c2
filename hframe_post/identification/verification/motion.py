"""The test motion of `verify`: a rectangle and a zigzag at the profile's limits, between marks.

It is played twice, plain and compensated. When recordings are judged, the part of a command that
is the motion, and its corners, are found again from the command itself.
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, Flags, X, Y, Z
from hframe_post.conversion.pipeline import Commands, Options
from hframe_post.identification.recordings.excitation import alignment_mark
from hframe_post.identification.recordings.sweep import Run, room
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import frozen

NAMES = ("none", "racking")  # the strategies that are compared
LENGTHS, LOOPS = (40.0, 20.0), 4  # sides of the rectangle in mm; how often it is traced
LEG, LEGS = 12.0, 6  # of the zigzag: mm along x, and number
QUIET = 1000  # samples of rest before, between and after the parts


def path(printer: Printer) -> list[bytes]:
    """Return the test motion as G-code, in the middle of the travel, at the printer's limits."""
    (x0, x1), (y0, y1) = printer.travel.x, printer.travel.y
    width, height = (min(length, (high - low) / 3.0) for length, (low, high) in zip(
        LENGTHS, ((x0, x1), (y0, y1)), strict=True))  # fmt: skip
    # off the middle, so that racking has a long lever arm
    left, low = (x0 + x1) / 2.0 + (x1 - x0) / 6.0 - width / 2.0, (y0 + y1) / 2.0 - height / 2.0
    speed = f"F{60.0 * printer.limits.velocity:g}"
    lines = ["G28", "G90", "M83", f"G1 X{left:.3f} Y{low:.3f} {speed}", "G4 P500"]
    for _ in range(LOOPS):
        corners = [(width, 0.0), (width, height), (0.0, height), (0.0, 0.0)]
        leg = min(LEG, width / LEGS)
        corners += [(leg * (k + 1), leg * ((k + 1) % 2)) for k in range(LEGS)]
        corners += [(0.0, 0.0)]
        lines += [f"G1 X{left + x:.3f} Y{low + y:.3f}" for x, y in corners]
    return [f"{line}\n".encode() for line in lines]


def runs(printer: Printer) -> list[Run]:
    """Return the plain and the compensated run. Raises HframeError."""
    options = Options("racking", limits="printer")
    source = Commands(path(printer), printer, options, NAMES)
    chunks = [chunk for chunk in source.computed() if len(chunk)]
    wanted = np.concatenate([chunk.xyze[:, :Z] for chunk in chunks])
    begin = _begin(wanted)
    made = []
    for name, strategy in (("verify-plain", "none"), ("verify-compensated", "racking")):
        motion = np.concatenate([chunk.commands[strategy] for chunk in chunks])[begin:]
        made.append(Run(name, X, (float(motion[0, X]), float(motion[0, Y])),
                        frozen(_framed(motion, printer))))  # fmt: skip
    return made


def _begin(wanted: Array) -> int:
    """Return the sample at which the test motion begins: after the last rest of the approach."""
    still = np.flatnonzero((np.diff(wanted, axis=0) == 0.0).all(axis=1))
    ends = still[np.diff(still, append=len(wanted) + 2) > 1]
    return int(ends[ends < len(wanted) // 2][-1])  # the motion is far longer than its approach


def _framed(motion: Array, printer: Printer) -> Array:
    limits = printer.limits
    left = min(room(printer, X, (float(p[X]), float(p[Y]))) for p in motion[[0, -1]])
    mark = alignment_mark(printer.sweep, limits.velocity, left)
    parts = []
    for at in motion[[0, -1]]:
        marked = np.tile(at, (len(mark), 1))
        marked[:, X] += mark
        parts.append(marked)
    first, last = (np.tile(at, (QUIET, 1)) for at in motion[[0, -1]])
    return np.concatenate([first, parts[0], first, motion, last, parts[1], last])


def motion_of(wanted: Array) -> slice:
    """Return which samples of a command (m, 2) are the test motion, without marks and rests."""
    moving = np.flatnonzero((np.diff(wanted, axis=0) != 0.0).any(axis=1))
    breaks = np.flatnonzero(np.diff(moving) > QUIET // 2)
    return slice(int(moving[breaks[0] + 1]), int(moving[breaks[-1]]) + 1)


def after_corners(wanted: Array) -> Flags:
    """Flag the samples (m,) within 150 ms after a corner of the path, a turn of over 0.3 rad."""
    step = np.diff(wanted, axis=0, append=wanted[-1:])
    moving = np.flatnonzero((step != 0.0).any(axis=1))
    heading = np.arctan2(step[moving, Y], step[moving, X])
    turn = np.abs(np.angle(np.exp(1j * np.diff(heading))))
    flags = np.zeros(len(wanted), dtype=bool)
    for k in moving[1:][turn > 0.3].tolist():
        flags[k : k + 150] = True
    return flags
