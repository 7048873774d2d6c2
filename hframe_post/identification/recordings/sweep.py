"""Runs of a sweep as G-code for Klipper, which records its accelerometers during each run.

Klipper stamps both calls of ACCELEROMETER_MEASURE with the print time at which the motion
before them ends, and keeps the samples between the two stamps. As long as Klipper's queue does
not run empty, print time advances by exactly the duration of each motion or G4. So a recording
begins with the first row of its command and ends with the last, if

- a dwell precedes the first call and still lasts while the sensor is being set up;
- no M400 comes between the calls: the stream must have begun before the first.

With several accelerometers the first one's second call waits for the end of the motion, so the
other recordings are longer. Klipper plays straight lines between the samples: the motion is the
command times sinc²(f·1 ms), 2 % less at 80 Hz, as in a print of every sample.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, Integers
from hframe_post.errors import HframeError, LimitError
from hframe_post.firmware.klipper.player import Klipper
from hframe_post.firmware.player import plain
from hframe_post.gcode.commands import STAMP
from hframe_post.identification.recordings import place_mark
from hframe_post.identification.recordings.accelerometer import FULL_SCALE
from hframe_post.identification.recordings.excitation import amplitude, peaks, trajectory
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import (
    Handling,
    ModalState,
    Passthrough,
    Pause,
    Samples,
    Standing,
    frozen,
)
from hframe_post.version import __version__
from hframe_post.writers.stream.gcode import GcodeWriter
from hframe_post.writers.stream.print_time import Output

OFFSETS = (-60.0, -30.0, 0.0, 30.0, 60.0)  # mm from x_c: where the paper measured (its Fig. 4)
APPROACH = 100.0  # mm/s, to the place of a run
LIFT = 5.0  # mm/s
SETTLED = 2000  # samples of standstill before a recording, in which the sensors are set up
CHIP_NAME = re.compile(r"[A-Za-z0-9_-]+")
STATE = "hframe_post_sweep"
HEAD = """\
; sweeps for the identification of printer {printer}, {version}
; Before printing this file: home (G28), clear the bed, bring hotend and bed to the temperature
; at which you print, and check that the accelerometers answer (ACCELEROMETER_QUERY).
; The nozzle rises to z {z} mm and moves in x and y; nothing is extruded.
SAVE_GCODE_STATE NAME={state}
"""


@dataclass(frozen=True, slots=True)
class Run:
    """One recording of a sweep.

    position: the x and y around which the axis moves, mm. command (n, 2): x and y every 1 ms,
    the first row at the first call of ACCELEROMETER_MEASURE, the last at the second.
    """

    name: str
    axis: int
    position: tuple[float, float]
    command: Array

    @property
    def seconds(self) -> float:
        return (len(self.command) - 1) * TS


def positions(printer: Printer) -> list[tuple[float, float]]:
    """Return the default places (x, y) in mm: the paper's, around x_c and in the middle of y.

    A printer that does not rack has no x_c; its places lie around the middle of x.
    """
    low, high = printer.travel.x
    racks = printer.plant.Gxtheta is not None
    centre = printer.plant.x_c if racks else (low + high) / 2.0
    reach = printer.sweep.stroke + printer.sweep.sway
    y = round(sum(printer.travel.y) / 2.0, 3)
    x = [round(centre + offset, 3) for offset in OFFSETS]
    inside = [p for p in x if low + reach <= p <= high - reach]
    return [(p, y) for p in inside] or [(round((low + high) / 2.0, 3), y)]


def runs(printer: Printer, axis: int, places: list[tuple[float, float]]) -> list[Run]:
    """Return one run along the axis (0: x, 1: y) at each place (x, y) in mm.

    Raises HframeError, and LimitError if a run would leave the travel or outrun a motor.
    """
    if len(set(places)) < len(places):
        raise HframeError("the same --position is given twice")
    # names such as x-at-110, with y added if two places have the same x
    shown = [tuple(plain(p, 3).replace("-", "m").replace(".", "_") for p in at) for at in places]
    alone = len({x for x, _ in shown}) == len(shown)
    names = [f"{'xy'[axis]}-at-{x}" + ("" if alone else f"-{y}") for x, y in shown]
    return [_run(printer, axis, *each) for each in zip(names, places, strict=True)]


def room(printer: Printer, axis: int, position: tuple[float, float]) -> float:
    """Return the distance (mm) along the axis to the nearer edge of the travel.

    Raises LimitError at an edge and beyond.
    """
    travel = (printer.travel.x, printer.travel.y)
    for name, at, (low, high) in zip("xy", position, travel, strict=True):
        if not low <= at <= high:
            bound = low if at < low else high
            raise LimitError(f"{name} (mm)", at, bound, None, "choose another --position")
    (low, high), at = travel[axis], position[axis]
    left = min(at - low, high - at)
    if left <= 0.0:
        raise LimitError(
            f"{'xy'[axis]} (mm)", at, at, None, "a --position at the edge leaves no room to move"
        )
    return left


def _run(printer: Printer, axis: int, name: str, position: tuple[float, float]) -> Run:
    left = room(printer, axis, position)
    rest = place_mark.rest(position[0])
    displacement = trajectory(printer.sweep, printer.limits.velocity, left, rest)
    command = np.tile(np.array(position), (len(displacement), 1))
    command[:, axis] += displacement
    for belt in printer.kinematics.belts(*(command - command[0]).T):
        _, v, a = peaks(belt)
        motors = printer.motors
        if v > motors.belt_velocity:
            advice = "lower limits.velocity or sweep.stroke in the profile"
            raise LimitError("belt velocity (mm/s)", v, motors.belt_velocity, None, advice)
        if a > motors.belt_acceleration:
            advice = "lower sweep.amplitude in the profile"
            raise LimitError("belt acceleration (mm/s²)", a, motors.belt_acceleration, None, advice)
    return Run(name, axis, position, frozen(command))


def summary(printer: Printer, run: Run) -> str:
    """Return one line about a run: its duration and peaks, and where it stays below the profile."""
    sweep = printer.sweep
    d, v, a = peaks(run.command[:, run.axis] - run.position[run.axis])
    left = room(printer, run.axis, run.position)
    hz = np.geomspace(sweep.start_hz, sweep.end_hz, 1000)
    commanded = amplitude(sweep, hz, printer.limits.velocity, left)
    line = f"{run.name}: {run.seconds:.3f} s, at most {d:.3g} mm, {v:.0f} mm/s, {a:.0f} mm/s²"
    reduced = commanded < 0.9 * sweep.amplitude
    if reduced.any():
        until = hz[np.flatnonzero(reduced)[-1]]
        line += (
            f"; below {until:.1f} Hz the acceleration stays below sweep.amplitude "
            f"({sweep.amplitude:g} mm/s²), limited by stroke, travel or speed "
            f"({commanded[0]:.0f} mm/s² at {hz[0]:g} Hz)"
        )
    clips = FULL_SCALE / float(commanded.max())
    if clips < 20.0:  # resonances of printers may amplify as much
        line += (
            f"; a resonance that amplifies {clips:.0f} times (damping {0.5 / clips:.2f} or less) "
            "exceeds the range of a 16 g sensor: lower sweep.amplitude if the recording clips"
        )
    return line


# ---------------------------------------------------------------------- output


def gcode(
    printer: Printer, planned: list[Run], chips: tuple[str, ...], z: float
) -> Iterator[Output]:
    """Yield the G-code of all runs. chips: Klipper's names of the accelerometers; z: mm."""
    stamp = f"{__version__}, printer {printer.name}, settings {printer.digest}"
    yield b"%s %s\n" % (STAMP, stamp.encode())
    height = plain(z, 3)
    head = HEAD.format(printer=printer.name, version=__version__, z=height, state=STATE)
    yield f"{head}G90\nG1 Z{height} F{plain(LIFT * 60.0, 1)}\n".encode()
    # Two digits more than a print: at 80 Hz a step of 1 µm is 250 mm/s² of acceleration. Kept in
    # time over 200 segments: a motion that is late at one frequency would look like the printer's
    # own delay. Over 16 s it would be late by 0.2 ms.
    writer = GcodeWriter("none", Klipper.from_printer(printer), 2, steady=200)
    yield from writer.write(_samples(planned, chips, z))
    yield f"RESTORE_GCODE_STATE NAME={STATE}\n".encode()


def _samples(planned: list[Run], chips: tuple[str, ...], z: float) -> Iterator[Samples]:
    first = 0
    for run in planned:
        x, y = (plain(p, 3) for p in run.position)
        approach = f"G90\nG0 X{x} Y{y} F{plain(APPROACH * 60.0, 1)}"
        here = (*run.position, z, 0.0)
        still = np.tile(np.array(run.position), (1 + SETTLED, 1))
        command = np.concatenate([still, run.command[1:]])
        measure = [f"ACCELEROMETER_MEASURE CHIP={chip}" for chip in chips]
        begun, end = first + len(still), first + len(command)
        events = (
            _passthrough(first, approach, Handling.RELEASE),
            # a move of zero length: the stream, with its limits, begins here, before the motion
            Pause(first + 1, 0, Standing(0, here, here, APPROACH)),
            _passthrough(begun, "\n".join(measure), Handling.REST),
            _passthrough(end, "\n".join(f"{m} NAME={run.name}" for m in measure), Handling.REST),
            _passthrough(end, "", Handling.RELEASE),
        )
        xyze = np.zeros((len(command), 4))
        xyze[:, :2], xyze[:, 2] = command, z
        line: Integers = np.zeros(len(command), dtype=np.int64)
        yield Samples(
            first, frozen(xyze), line, events, {"none": frozen(command)}, ends_stretch=True
        )
        first = end


def _passthrough(index: int, text: str, handling: Handling) -> Pause:
    state = ModalState(True, False, 0.0, APPROACH, (0.0, 0.0, 0.0))
    return Pause(index, 0, Passthrough(0, text.encode(), handling, state))
