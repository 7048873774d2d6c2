"""The test motion of `verify`: a rectangle and a zigzag, or part of a print.

It is played twice, plain and compensated. When recordings are judged, the part of a command that
is the motion, and its corners, are found again from the command itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from hframe_post.arrays import TS, Array, Flags, X, Y
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import SampleStream
from hframe_post.errors import HframeError, LimitError
from hframe_post.identification.recordings.runs import PlannedRun, check_records
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Samples, frozen

STRATEGIES = {"verify-plain": "none", "verify-compensated": "racking"}  # by the names of runs
LENGTHS, LOOPS = (40.0, 20.0), 4  # sides of the rectangle in mm; how often it is traced
LEG, LEGS = 12.0, 6  # of the zigzag: mm along x, and number
LOOKED_AT, LONGEST, SHORTEST = 250_000, 40_000, 5_000  # samples of a print: of these, from … to
SHORTEST_STOP, AT_REST = 20, 1e-9  # samples and mm per sample at rest
GENTLER = (1.0, 0.7, 0.5, 0.35)  # shares of the path's acceleration and jerk, tried in turn
QUIET = 1000  # samples of rest before and after it


def path(printer: Printer) -> list[bytes]:
    """Return the test motion as G-code, in the middle of the travel, at the printer's limits."""
    (x0, x1), (y0, y1) = printer.travel.x, printer.travel.y
    width, height = (min(length, (high - low) / 3.0) for length, (low, high) in zip(
        LENGTHS, ((x0, x1), (y0, y1)), strict=True))  # fmt: skip
    # the model holds in the middle; away from it racking has a long lever arm
    off = (x1 - x0) / 6.0 if printer.plant.Gxtheta is not None else 0.0
    left, low = (x0 + x1) / 2.0 + off - width / 2.0, (y0 + y1) / 2.0 - height / 2.0
    speed = f"F{60.0 * printer.limits.velocity:g}"
    lines = ["G28", "G90", "M83", f"G1 X{left:.3f} Y{low:.3f} {speed}", "G4 P500"]
    for _ in range(LOOPS):
        corners = [(width, 0.0), (width, height), (0.0, height), (0.0, 0.0)]
        leg = min(LEG, width / LEGS)
        corners += [(leg * (k + 1), leg * ((k + 1) % 2)) for k in range(LEGS)]
        corners += [(0.0, 0.0)]
        lines += [f"G1 X{left + x:.3f} Y{low + y:.3f}" for x, y in corners]
    return [f"{line}\n".encode() for line in lines]


def runs(printer: Printer, lines: Iterable[bytes] | None = None) -> list[PlannedRun]:
    """Return the plain and the compensated run: of the test motion, or of a print's beginning.

    lines: the print's G-code. Nothing is extruded, and z does not move. The test motion is gentler
    where the motors cannot follow it at the printer's limits. Raises HframeError.
    """
    check_records(printer)
    if lines is not None:
        return _runs(printer, lines, part_of_print=True)
    limits = printer.limits
    for share in GENTLER:
        gentler = replace(
            limits, acceleration=share * limits.acceleration, jerk=share * limits.jerk
        )
        try:
            return _runs(replace(printer, limits=gentler), path(printer), part_of_print=False)
        except LimitError as error:
            found = error
    raise HframeError(
        f"even with {GENTLER[-1]:g} of limits.acceleration the {found.quantity} of the compensated "
        f"test motion would be {found.value:.6g}, the printer's limit is {found.bound:.6g}. Raise "
        "the limits under [motors] if the motors can do it, or lower those under [limits]"
    )


def _runs(printer: Printer, lines: Iterable[bytes], part_of_print: bool) -> list[PlannedRun]:
    options = Options("racking", limits="printer", clamp=False)
    chunks = list[Samples]()
    for chunk in SampleStream(lines, printer, options, tuple(STRATEGIES.values())).computed():
        if len(chunk):
            chunks.append(chunk)
        if chunk.end > LOOKED_AT:
            break
    if not chunks:
        raise HframeError("the print does not move in x and y")
    commands = {
        run: np.concatenate([chunk.commands[strategy] for chunk in chunks])[:LOOKED_AT]
        for run, strategy in STRATEGIES.items()
    }
    part = slice(None)
    if part_of_print:
        ends = [chunk.end for chunk in chunks if chunk.ends_stretch]
        part = _between_stops(commands["verify-compensated"], ends)
    return [
        PlannedRun(run, X, (float(command[part][0, X]), float(command[part][0, Y])),
            frozen(np.pad(command[part], ((QUIET, QUIET), (0, 0)), mode="edge")))
        for run, command in commands.items()
    ]  # fmt: skip


def _between_stops(command: Array, ends: Sequence[int]) -> slice:
    """Return the longest part of at most ``LONGEST`` samples from one stop to another.

    command (m, 2): mm; ends: samples after which the machine moves on its own.
    """
    still = (np.abs(np.diff(command, axis=0)) < AT_REST).all(axis=1)
    edges = np.flatnonzero(np.diff(still, prepend=False, append=False))
    first, last = edges[::2], edges[1::2]
    stops = [(int(a), int(b)) for a, b in zip(first, last, strict=True) if b - a >= SHORTEST_STOP]
    best = slice(0, 0)
    for k, (_, start) in enumerate(stops):
        own = min((end for end in ends if end > start), default=len(command))
        for stop, _ in stops[k + 1 :]:
            if stop <= own and best.stop - best.start < stop - start <= LONGEST:
                best = slice(start, stop + 1)
    if best.stop - best.start < SHORTEST:
        raise HframeError(
            f"the print's first {LOOKED_AT * TS:.0f} s have no part of {SHORTEST * TS:.0f} to "
            f"{LONGEST * TS:.0f} s between two stops. Choose another print, or leave it out"
        )
    return best


def motion_of(wanted: Array) -> slice:
    """Return which samples of a command (m, 2) are the test motion, without rests."""
    moving = np.flatnonzero((np.diff(wanted, axis=0) != 0.0).any(axis=1))
    return slice(int(moving[0]), int(moving[-1]) + 1)


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
