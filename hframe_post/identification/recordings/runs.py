"""Runs as G-code for Klipper, which records its accelerometers during each run.

Klipper stamps both calls of ACCELEROMETER_MEASURE with the print time at which the motion
before them ends, and keeps the samples between the two stamps. As long as Klipper's queue does
not run empty, print time advances by exactly the duration of each motion or G4. So a recording
begins with the first row of its command and ends with the last, if

- a dwell precedes the first call and still lasts while the sensor is being set up;
- no M400 comes before the end of the motion: the stream must have begun before the first call.

With several accelerometers the first one's second call waits for the end of the motion, so the
other recordings are longer.

A start that is known to a sample is not known exactly. A run is therefore ended by the macro
RECORDED of hframe.cfg: after M400, print time is that at which the motion has ended, and the macro
puts it into the recording's name. G-code cannot tell whether the macro is installed. So the plain
call follows. Where the macro has ended the recording, that begins another one, which the macro
ends at once under the name UNUSED.

Klipper plays straight lines between the samples: the motion is the command times sinc²(f·1 ms),
2 % less at 80 Hz, as in a print of every sample.

Between the samples the speed changes in a part of each millisecond, so Klipper must allow a
multiple of the run's acceleration while a run lasts. A cancelled file leaves that in force.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, Integers, X, Y, Z
from hframe_post.errors import HframeError, LimitError
from hframe_post.firmware.code import plain
from hframe_post.firmware.klipper.klipper_stream import KlipperCode, KlipperMotion, stream_limits
from hframe_post.firmware.registry import Klipper, firmware
from hframe_post.gcode.commands import STAMP
from hframe_post.printer.firmware_tables import RECORDED, USUAL_CHIP
from hframe_post.printer.settings import VELOCITY_HEADROOM, Printer
from hframe_post.stream.types import (
    Dwell,
    Handling,
    ModalState,
    MoveAtRest,
    Passthrough,
    Samples,
    frozen,
)
from hframe_post.version import __version__
from hframe_post.writers.gcode import GcodeWriter
from hframe_post.writers.print_time import Output, duration

OUTER = 60.0  # mm from the middle of x to the outer places: the paper's longest arm (its Fig. 4)
NEAREST = 10.0  # mm; racking cannot be found from places that are closer
LEAST_ROOM = 5.0  # mm from a place to the edge of the travel
MULTIPLE = 3.5  # of a run's acceleration, allowed to Klipper: with 3 it is late by 0.03 ms
APPROACH = 100.0  # mm/s, to the place of a run
LIFT = 5.0  # mm/s
SETTLED = 2000  # samples of rest before a recording, in which the sensors are set up
QUIET = 1000  # samples of rest at both ends of a command, in which gravity shows
STATE = "hframe_post_measure"
HEAD = """\
; accelerometer runs for printer {printer}, {version}: {runs}, {total}
; Before printing this file: home (G28), clear the bed, bring hotend and bed to the temperature
; at which you print, and check that the accelerometers answer (ACCELEROMETER_QUERY).
; The nozzle rises to z {z} mm and moves in x and y; nothing is extruded.
; If you cancel it, Klipper keeps this file's limits: run FIRMWARE_RESTART. Where hframe.cfg is
; included, cancelling restores the printer's limits by itself.
SAVE_GCODE_STATE NAME={state}
"""


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """A motion that is recorded.

    command (n, 2): x and y, mm, every 1 ms; Klipper records from the first row to the last. The
    recording's name ends with ``name`` and the time of the end.
    """

    name: str
    command: Array

    @property
    def axis(self) -> int:
        """Return the axis that moves, X if both do."""
        return X if np.ptp(self.command[:, X]) > 0.0 else Y

    @property
    def seconds(self) -> float:
        return (len(self.command) - 1) * TS


def positions(printer: Printer, axis: int) -> list[tuple[float, float]]:
    """Return the default places (x, y) in mm for runs of an axis (0: x, 1: y).

    It is the middle of the travel. Where the printer can rack, x moves on both sides of it, too:
    the lever arms of racking differ there, and x_c is unknown before the measurement.
    """
    (low, high), y = printer.travel.x, round(sum(printer.travel.y) / 2.0, 3)
    middle = (low + high) / 2.0
    away = min(OUTER, (high - low) / 2.0 - LEAST_ROOM)
    if axis != X or not printer.kinematics.racks or away < NEAREST:
        return [(round(middle, 3), y)]
    return [(round(middle + offset, 3), y) for offset in (-away, 0.0, away)]


def allowed(printer: Printer, share: float, multiple: float) -> tuple[float, float]:
    """Return the mm/s and mm/s² of a run that the limits, the motors and the firmware allow.

    share: of the belts' speed that an axis may have. multiple: of the run's acceleration, that the
    motors must allow the firmware.
    """
    limits, motors = printer.limits, printer.motors
    velocity = min(limits.velocity, share * motors.belt_velocity)
    acceleration = min(limits.acceleration, stream_limits(printer).acceleration / multiple)
    most = firmware(printer).most()
    return min(velocity, most[0]), min(acceleration, most[1])


def named(
    prefix: str, printer: Printer, axis: int, places: Sequence[tuple[float, float]]
) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield the places for runs of an axis, ``positions`` if none is given, with their names.

    Such as x-at-110, with y added if two have the same x. Raises HframeError if a place is given
    twice.
    """
    places = places or positions(printer, axis)
    if len(set(places)) < len(places):
        raise HframeError("the same --position is given twice")
    shown = [tuple(plain(p, 3).replace("-", "m").replace(".", "_") for p in at) for at in places]
    alone = len({x for x, _ in shown}) == len(shown)
    names = (f"{prefix}-at-{x}" + ("" if alone else f"-{y}") for x, y in shown)
    yield from zip(names, places, strict=True)


def room(printer: Printer, axis: int, position: tuple[float, float]) -> float:
    """Return the distance (mm) along the axis to the nearer edge of the travel.

    Raises LimitError beyond the travel, and where there is too little room to move.
    """
    travel = (printer.travel.x, printer.travel.y)
    for name, at, (low, high) in zip("xy", position, travel, strict=True):
        if not low <= at <= high:
            bound = low if at < low else high
            raise LimitError(f"{name} (mm)", at, bound, None, "choose another --position")
    at = position[axis]
    left = min(abs(at - edge) for edge in travel[axis])
    if left < LEAST_ROOM:
        raise LimitError(
            f"room to either side in {'xy'[axis]} (mm)", left, LEAST_ROOM, None,
            "choose a --position farther from the edge",
        )  # fmt: skip
    return left


def moves_sensor(printer: Printer, planned: Sequence[PlannedRun], chips: Sequence[str]) -> bool:
    """Return whether one sensor must be moved from head to bed between runs of x and of y."""
    both = {run.axis for run in planned} == {X, Y}
    sensors = {chip for run in planned for chip in recording_chips(printer, run, chips)}
    return printer.kinematics.bed_moves and both and len(sensors) == 1


def seconds_of(planned: Sequence[PlannedRun]) -> float:
    """Return the time in all, with the ways between the places but not the one to the first."""
    ways = np.diff([run.command[0] for run in planned], axis=0)
    on_the_way = float(np.hypot(*ways.T).sum()) / APPROACH if len(planned) > 1 else 0.0
    return on_the_way + sum(run.seconds + SETTLED * TS for run in planned)


# ---------------------------------------------------------------------- output


def gcode(
    printer: Printer, planned: list[PlannedRun], chips: tuple[str, ...], z: float
) -> Iterator[Output]:
    """Yield the G-code of all runs. z: mm.

    chips: Klipper's names of the accelerometers; empty: those of the profile for each axis.
    """
    stamp = f"{__version__}, printer {printer.name}, settings {printer.digest}"
    yield b"%s %s\n" % (STAMP, stamp.encode())
    height = plain(z, 3)
    head = HEAD.format(
        printer=printer.name, version=__version__, runs=", ".join(run.name for run in planned),
        total=duration(seconds_of(planned)), z=height, state=STATE,
    )  # fmt: skip
    yield f"{head}G90\nG1 Z{height} F{plain(LIFT * 60.0, 1)}\n".encode()
    # Two digits more than a print: at 80 Hz a step of 1 µm is 250 mm/s² of acceleration. Kept in
    # time over 200 segments: a motion that is late at one frequency would look like the printer's
    # own delay. Over 16 s it would be late by 0.2 ms.
    writer = GcodeWriter("none", *_klipper(printer, planned), 2, steady=200)
    sensors = [recording_chips(printer, run, chips) for run in planned]
    yield from writer.write(_samples(planned, sensors, z))
    yield f"RESTORE_GCODE_STATE NAME={STATE}\n".encode()


def recording_chips(printer: Printer, run: PlannedRun, chips: Sequence[str]) -> tuple[str, ...]:
    """Return Klipper's names of the accelerometers that record a run.

    chips: those that were asked for; else each axis that moves is recorded by its own.
    """
    if chips:
        return tuple(dict.fromkeys(chips))
    known = printer.sweep.chip_x, printer.sweep.chip_y
    moved = np.ptp(run.command, axis=0) > 0.0
    found = [chip for chip, moves in zip(known, moved, strict=True) if chip and moves]
    return tuple(dict.fromkeys(found)) or (USUAL_CHIP,)


def _klipper(printer: Printer, planned: list[PlannedRun]) -> tuple[KlipperMotion, KlipperCode]:
    """Return Klipper with limits no higher than the runs need, since a cancel leaves them."""
    own = Klipper(printer)
    motion, code = own.motion(None), own.code()
    speed, acceleration = (
        max(np.linalg.norm(np.diff(run.command, n=n, axis=0), axis=1).max() for run in planned)
        / TS**n
        for n in (1, 2)
    )
    limits = replace(
        motion.limits,
        velocity=min(motion.limits.velocity, math.ceil(VELOCITY_HEADROOM * speed)),
        acceleration=min(motion.limits.acceleration, math.ceil(MULTIPLE * acceleration)),
    )
    return replace(motion, limits=limits), replace(code, stream=limits)


def _samples(
    planned: list[PlannedRun], sensors: Sequence[tuple[str, ...]], z: float
) -> Iterator[Samples]:
    first = 0
    for run, chips in zip(planned, sensors, strict=True):
        x, y = run.command[0].tolist()
        approach = f"G90\nG0 X{plain(x, 3)} Y{plain(y, 3)} F{plain(APPROACH * 60.0, 1)}"
        here = (x, y, z, 0.0)
        still = np.tile(run.command[0], (1 + SETTLED, 1))
        command = np.concatenate([still, run.command[1:]])
        measure = [f"ACCELEROMETER_MEASURE CHIP={chip}" for chip in chips]
        begun, end = first + len(still), first + len(command)
        events = (
            _passthrough(first, approach, Handling.RELEASE),
            # a move of zero length: the stream, with its limits, begins here, before the motion
            Dwell(first + 1, 0, MoveAtRest(0, here, here, APPROACH)),
            _passthrough(begun, "\n".join(measure), Handling.REST),
            _passthrough(end, "\n".join(_end_of_recording(run, chips)), Handling.REST),
            _passthrough(end, "", Handling.RELEASE),
        )
        xyze = np.pad(command, ((0, 0), (0, 2)))
        xyze[:, Z] = z
        line: Integers = np.zeros(len(command), dtype=np.int64)
        yield Samples(
            first, frozen(xyze), line, events, {"none": frozen(command)}, ends_stretch=True
        )
        first = end


def _end_of_recording(run: PlannedRun, chips: Sequence[str]) -> Iterator[str]:
    calls = [f"ACCELEROMETER_MEASURE CHIP={chip} NAME={run.name}" for chip in chips]
    macro = f"{RECORDED} CHIPS={','.join(chips)}"
    yield from ("M400", f"{macro} NAME={run.name}", *calls, macro)


def _passthrough(index: int, text: str, handling: Handling) -> Dwell:
    state = ModalState(True, False, 0.0, APPROACH, (0.0, 0.0, 0.0))
    return Dwell(index, 0, Passthrough(0, text.encode(), handling, state))
