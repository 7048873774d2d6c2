"""A sweep of moves as they are written, for firmwares that record no accelerometers.

Some of these play no sine: Marlin has whole steps and a short queue.

The axis travels to and fro around its place, and while it travels its speed pulses:

    slow, fast, slow, fast, …     each a move; a fast one rises from the slow speed and returns

So the acceleration is +a, 0, −a, 0 … at a frequency that grows. The axis stops only where it
turns, so friction, and the first step from rest, which Marlin delays, hardly count. The command is
what the firmware makes of the moves, of Marlin each step (``firmware.motion``).

Any program may record it: start and clock are found from the motion (``self_alignment``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hframe_post.arrays import TS, Array, Integers, X, Y
from hframe_post.errors import LimitError
from hframe_post.firmware.code import plain
from hframe_post.firmware.motion import USED_LINES_SHARE, WrittenMoves
from hframe_post.firmware.registry import firmware
from hframe_post.gcode.commands import OFF
from hframe_post.identification.recordings.runs import (
    APPROACH,
    LIFT,
    MULTIPLE,
    QUIET,
    SETTLED,
    PlannedRun,
    allowed,
    named,
    room,
)
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import ModalState, frozen
from hframe_post.version import __version__

SLOW, RISE = 20.0, 60.0  # mm/s between pulses, and most that a pulse adds
REACH = 25.0  # mm to either side of the place
START_HZ = 4.0
BEFORE = 5000  # samples of rest before the motion, in which gravity shows
HEAD = """\
; accelerometer run {name} for printer {printer}, {version}: {seconds:.0f} s
; Before printing this file: home (G28), clear the bed, bring hotend and bed to the temperature at
; which you print, screw the accelerometer to {part}, and start to record all of its axes.
; The nozzle rises to z {z} mm and moves in {axis}; nothing is extruded.
; If you cancel it, {after_cancel}
"""


def runs(
    printer: Printer, places: Sequence[tuple[float, float]], z: float
) -> list[tuple[PlannedRun, list[str]]]:
    """Return a run along x and one along y at each place (x, y) in mm, by default as for strokes.

    Each as it is played, and the G-code for it. z: mm. Raises HframeError.
    """
    return [
        played(printer, name, axis, at, z)
        for axis in (X, Y)
        for name, at in named("xy"[axis], printer, axis, places)
    ]


def played(
    printer: Printer, name: str, axis: int, place: tuple[float, float], z: float
) -> tuple[PlannedRun, list[str]]:
    """Return a run along an axis (X or Y) as it is played, and the G-code for it. place, z: mm.

    Raises PrinterError if the profile lacks the firmware's table, and LimitError without room or
    speed.
    """
    own = firmware(printer)
    play = own.moves()
    x, y = (round(at / play.step) * play.step for at in place)
    reach = min(room(printer, axis, place), REACH)
    sweep, (velocity, acceleration) = printer.sweep, allowed(printer, 1.0, MULTIPLE)
    if velocity < 2.0 * SLOW:
        raise LimitError("speed (mm/s)", velocity, 2.0 * SLOW, None, "raise limits.velocity")
    a = float(np.floor(min(sweep.amplitude, acceleration)))
    lines_per_second = own.motion(None).lines_per_second
    end_hz = min(sweep.end_hz, USED_LINES_SHARE * lines_per_second / 2.0)  # two lines a period
    pulses = _pulses(play, a, min(RISE, velocity - SLOW), reach, end_hz, sweep.rate_hz_per_s)
    steps, v = (np.array(column) for column in zip(*pulses, strict=True))
    v = np.round(60.0 * v, 1) / 60.0  # as F has it
    cells = np.zeros((len(v) + 1, 2), dtype=np.int64)
    cells[1:, axis] = np.cumsum(steps)
    turns = _turns(np.sign(steps), v, play.reversal)
    along = np.pad(play.motion(cells, v, turns, a), QUIET, mode="edge")
    command = np.tile(np.array([x, y]), (len(along), 1))
    command[:, axis] += along
    done = PlannedRun(name, frozen(command))
    ends = (x, y)[axis] + cells[1:, axis] * play.step
    return done, _gcode(printer, play, done, np.asarray(ends), v, a, z)


def summary(stem: str, played: list[PlannedRun], bed_may_move: bool) -> str:
    """Return what the owner does with the files of the runs, whose names begin with ``stem``."""
    lines = [
        f"{stem}.{run.name}.gcode: {run.seconds + (BEFORE + SETTLED) * TS:.0f} s" for run in played
    ]
    lines.append(
        "For each file: home, start to record all axes of the accelerometer, print the file from "
        "SD, stop, and save the recording as recordings/RUN.csv, for example "
        f"{played[0].name}.csv. Copy the CSV files that were written here into recordings, too"
    )
    if bed_may_move and any(run.axis for run in played):
        lines.append("If the bed moves in y, screw the accelerometer to the bed for y")
    return "\n".join(lines)


def _pulses(
    play: WrittenMoves, a: float, most: float, reach: float, end_hz: float, rate: float
) -> Iterator[tuple[int, float]]:
    """Yield steps and speed of each move."""
    step, least = play.step, play.least
    shortest = least * step / SLOW
    at, way, hz = 0.0, 1, START_HZ
    turn = [(least, play.speed(play.reversal))] if play.reversal else []
    yield from turn
    while hz <= end_hz:
        period = 1.0 / hz
        hz += rate * period
        rise = min(a * (period - shortest) / 2.0, most)
        ramp = rise / a
        hold = max((period - 2.0 * ramp - shortest) / 2.0, 0.0)  # at full speed, and as long slow
        slow = max(least, round(SLOW * (period - 2.0 * ramp - hold) / step))
        fast = (SLOW * (2.0 * ramp + hold) + rise * (ramp + hold)) / step
        fast = max(least, 2 * round(fast / 2.0))  # even: both ramps have as many steps
        top = _safe_speed(play, a, SLOW + rise, fast)
        travel = (slow + fast) * step
        if travel > reach:
            continue  # too slow for the room that there is
        if way * at + travel > reach:
            yield from ((side * n, v) for side in (way, -way) for n, v in turn)
            way = -way
        at += way * travel
        for n, v in ((slow, SLOW), (fast, top)):
            yield way * n, play.speed(v)
    yield from ((way * n, v) for n, v in turn)


def _turns(way: Integers, v: Array, reversal: float) -> Array:
    """Return the most speed (k + 1,) at the ends of moves, where the axis turns or rests, too.

    way (k,): 1 or -1; v (k,): speeds. reversal: speed at a turn and at the start, 0 at rest.
    """
    same = np.diff(np.pad(way, 1)) == 0
    v = np.pad(v, 1)
    passed = np.where(same, np.minimum(v[:-1], v[1:]), reversal)
    passed[-1] = 0.0
    return np.asarray(passed)


def _safe_speed(play: WrittenMoves, a: float, most: float, steps: int) -> float:
    """Return the top speed, mm/s, of a move between slow ones, with ramps of k + 1/2 steps.

    A firmware that counts steps rounds them to k or k + 1, and both ramps leave room for that.
    With whole steps, or with ramps that meet, the last digit of its numbers would decide on k, and
    with it on half a millisecond.
    """
    base, per_step = SLOW**2, 2.0 * a * play.step
    k = min(steps // 2 - 1, int((most**2 - base) / per_step - 0.5))
    return float(np.sqrt(base + per_step * (k + 0.5)))


def _gcode(
    printer: Printer, play: WrittenMoves, run: PlannedRun, at: Array, v: Array, a: float, z: float
) -> list[str]:
    """Return the lines of the file. at (k,): where each move ends along the axis."""
    axis, height = "XY"[run.axis], plain(z, 3)
    part = ("the print head", "the bed if it moves in y, otherwise to the print head")[run.axis]
    head = HEAD.format(
        name=run.name, printer=printer.name, version=__version__, seconds=run.seconds, part=part,
        z=height, axis=axis.lower(), after_cancel=play.after_cancel,
    )  # fmt: skip
    x, y = (plain(place, 3) for place in run.command[0].tolist())
    begin = [
        *play.begin, "G90", f"G1 Z{height} F{plain(LIFT * 60.0, 1)}",
        f"G1 X{x} Y{y} F{plain(APPROACH * 60.0, 1)}",
        *play.limits(float(v.max()) + 1.0, a), f"G4 P{BEFORE}",
        *play.ahead(z),
    ]  # fmt: skip
    feeds = (plain(speed * 60.0, 1) for speed in v.tolist())
    places = (plain(place, 4) for place in at.tolist())
    moves = [f"G1 {axis}{place} F{feed}" for place, feed in zip(places, feeds, strict=True)]
    last = np.array([*run.command[0], z, 0.0])
    last[run.axis] = at[-1]
    state = ModalState(True, False, 0.0, APPROACH, (0.0, 0.0, 0.0))
    end = play.code.end(state, last)
    return [OFF.decode(), *head.splitlines(), *begin, *moves, f"G4 P{SETTLED}", *end]
