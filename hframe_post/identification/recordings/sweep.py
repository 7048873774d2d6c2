"""Runs of a sweep as G-code for Klipper, each with a recording by its accelerometers.

Klipper stamps both calls of ACCELEROMETER_MEASURE with the print time at which the motion
before them ends, and keeps the samples between the two stamps. Print time advances by just
what a motion or a G4 takes as long as Klipper's queue does not run empty. So a recording
begins with the first row of its command and ends with the last, if

- a dwell comes right before the first call, to be still going on while the sensor is set up;
- no M400 comes between the calls: the stream must have begun before the first.

Of several accelerometers the first one's second call waits for the motion to end, so the
recordings of the others last longer. Klipper plays straight lines between the samples: what
moves is the command times sinc²(f·1 ms), 2 % less at 80 Hz, as in a print of every sample.
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
from hframe_post.writers.stream.deferred import Output
from hframe_post.writers.stream.gcode import GcodeWriter

AROUND = (-60.0, -30.0, 0.0, 30.0, 60.0)  # mm from x_c: where the paper measured (its Fig. 4)
APPROACH = 100.0  # mm/s, to the place of a run
LIKELY = 20.0  # times, up to which a resonance of a printer may amplify
LIFT = 5.0  # mm/s
FINER = 2  # digits more than a print's: at 80 Hz a step of 1 µm is 250 mm/s² of acceleration
IN_TIME = 200  # segments over which the motion may be late; over 16 s it would be by 0.2 ms
SETTLED = 2000  # samples of standstill before a recording, while which sensors are set up
NAME = re.compile(r"[A-Za-z0-9_-]+")
STATE = "hframe_post_sweep"
HEAD = """\
; sweeps for the identification of printer {printer}, {version}
; Before it: home (G28), clear the bed, leave hotend and bed as cold or warm as is wanted,
; see that the accelerometers answer (ACCELEROMETER_QUERY).
; It takes the nozzle to z {z} mm and moves in x and y; nothing is extruded.
SAVE_GCODE_STATE NAME={state}
"""


@dataclass(frozen=True, slots=True)
class Run:
    """One recording. position: x and y in the middle of it, mm; command (n, 2): x and y every
    1 ms, the first row at the first call, the last at the second."""

    name: str
    axis: int
    position: tuple[float, float]
    command: Array

    @property
    def seconds(self) -> float:
        """From the first call to the second."""
        return (len(self.command) - 1) * TS


def positions(printer: Printer) -> list[tuple[float, float]]:
    """Where to measure if nothing is said: the paper's places around x_c, y in the middle.

    A printer that does not rack has no x_c: around the middle of x.
    """
    low, high = printer.travel.x
    racks = printer.plant.Gxtheta is not None
    centre = printer.plant.x_c if racks else (low + high) / 2.0
    reach = printer.sweep.stroke + printer.sweep.sway
    y = round(sum(printer.travel.y) / 2.0, 3)
    x = [round(centre + offset, 3) for offset in AROUND]
    inside = [p for p in x if low + reach <= p <= high - reach]
    return [(p, y) for p in inside] or [(round((low + high) / 2.0, 3), y)]


def runs(printer: Printer, axis: int, places: list[tuple[float, float]]) -> list[Run]:
    """One run along the axis (0, 1) at each place, checked whole. Raises HframeError."""
    names = _names("xy"[axis], places)
    return [_run(printer, axis, *each) for each in zip(names, places, strict=True)]


def _names(axis: str, places: list[tuple[float, float]]) -> list[str]:
    """``x-at-110``, and with y where x does not tell the places apart."""
    if len(set(places)) < len(places):
        raise HframeError("a position is given twice")
    shown = [tuple(plain(p, 3).replace("-", "m").replace(".", "_") for p in at) for at in places]
    alone = len({x for x, _ in shown}) == len(shown)
    return [f"{axis}-at-{x}" if alone else f"{axis}-at-{x}-{y}" for x, y in shown]


def room(printer: Printer, axis: int, position: tuple[float, float]) -> float:
    """mm to the nearer edge of the travel along the axis. Raises LimitError beyond an edge."""
    for name, at, (low, high) in zip("xy", position, _travel(printer), strict=True):
        if not low <= at <= high:
            bound = low if at < low else high
            raise LimitError(f"{name} (mm)", at, bound, None, "choose another --position")
    (low, high), at = _travel(printer)[axis], position[axis]
    left = min(at - low, high - at)
    if left <= 0.0:
        raise LimitError(
            f"{'xy'[axis]} (mm)", at, at, None, "a --position at the edge leaves no room to move"
        )
    return left


def _travel(printer: Printer) -> tuple[tuple[float, float], tuple[float, float]]:
    return printer.travel.x, printer.travel.y


def _run(printer: Printer, axis: int, name: str, position: tuple[float, float]) -> Run:
    left = room(printer, axis, position)
    displacement = trajectory(
        printer.sweep, printer.limits.velocity, left, place_mark.rest(position[0])
    )
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


def told(printer: Printer, run: Run) -> str:
    """One line for a person: how long, how far, how fast, and where less than asked."""
    sweep = printer.sweep
    d, v, a = peaks(run.command[:, run.axis] - run.position[run.axis])
    left = room(printer, run.axis, run.position)
    hz = np.geomspace(sweep.start_hz, sweep.end_hz, 1000)
    given = amplitude(sweep, hz, printer.limits.velocity, left)
    line = f"{run.name}: {run.seconds:.3f} s, at most {d:.3g} mm, {v:.0f} mm/s, {a:.0f} mm/s²"
    less = given < 0.9 * sweep.amplitude
    if less.any():
        until = hz[np.flatnonzero(less)[-1]]
        line += (
            f"; LESS than the amplitude of {sweep.amplitude:g} mm/s² below {until:.1f} Hz, where "
            f"stroke, travel or speed limit it ({given[0]:.0f} mm/s² at {hz[0]:g} Hz)"
        )
    clips = FULL_SCALE / float(given.max())
    if clips < LIKELY:
        line += (
            f"; a resonance that amplifies {clips:.0f} times (damping {0.5 / clips:.2f} or less) "
            "takes a sensor of 16 g to its end: lower sweep.amplitude if it clips"
        )
    return line


# ---------------------------------------------------------------------- output


def gcode(
    printer: Printer, planned: list[Run], chips: tuple[str, ...], z: float
) -> Iterator[Output]:
    """The file of all runs. chips: Klipper's names of the accelerometers; z: mm."""
    stamp = f"{__version__}, printer {printer.name}, settings {printer.digest}"
    yield b"%s %s\n" % (STAMP, stamp.encode())
    height = plain(z, 3)
    head = HEAD.format(printer=printer.name, version=__version__, z=height, state=STATE)
    yield f"{head}G90\nG1 Z{height} F{plain(LIFT * 60.0, 1)}\n".encode()
    yield from _writer(printer).write(_samples(planned, chips, z))
    yield f"RESTORE_GCODE_STATE NAME={STATE}\n".encode()


def _writer(printer: Printer) -> GcodeWriter:
    """One that keeps time: what it is late by at one frequency would pass for the printer's lag."""
    return GcodeWriter("none", Klipper.from_printer(printer), FINER, steady=IN_TIME)


def _samples(planned: list[Run], chips: tuple[str, ...], z: float) -> Iterator[Samples]:
    """What the writer takes: approach, standstill, the recorded motion, handing back."""
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
            _passed(first, approach, Handling.RELEASE),
            # a move of no length: the stream, with its limits, begins here and not with the motion
            Pause(first + 1, 0, Standing(0, here, here, APPROACH)),
            _passed(begun, "\n".join(measure), Handling.REST),
            _passed(end, "\n".join(f"{m} NAME={run.name}" for m in measure), Handling.REST),
            _passed(end, "", Handling.RELEASE),
        )
        xyze = np.zeros((len(command), 4))
        xyze[:, :2], xyze[:, 2] = command, z
        line: Integers = np.zeros(len(command), dtype=np.int64)
        yield Samples(
            first, frozen(xyze), line, events, {"none": frozen(command)}, ends_stretch=True
        )
        first = end


def _passed(index: int, text: str, handling: Handling) -> Pause:
    state = ModalState(True, False, 0.0, APPROACH, (0.0, 0.0, 0.0))
    return Pause(index, 0, Passthrough(0, text.encode(), handling, state))
