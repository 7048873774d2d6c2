"""Strokes at one speed after the other, in directions in which only one motor turns.

Klipper records each speed by itself, in a file named as Shake&Tune names it. The strokes are plain
moves, so that nothing but the motor shakes the nozzle between the turns.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.errors import LimitError
from hframe_post.firmware.code import plain
from hframe_post.gcode.commands import STAMP
from hframe_post.identification.recordings.runs import APPROACH, LIFT, check_records, room
from hframe_post.printer.firmware_tables import USUAL_CHIP
from hframe_post.printer.settings import Printer
from hframe_post.version import __version__
from hframe_post.writers.stream.print_time import duration

SLOWEST, FASTEST, STEP = 10.0, 200.0, 2.0  # mm/s of the path
GENTLE = 3000.0  # mm/s²: what the turns shake has ended soon
STROKE, RECORDED = 0.6, 1.2  # s that a stroke takes, and strokes of a recording together
SHORTEST = 10.0  # mm
MARGIN = 1.0  # mm from the edge
SETTLED = 300  # ms at rest before a recording
HEAD = """\
; strokes at constant speeds for printer {printer}, {version}: {runs} recordings, {total}
; Before printing this file: home (G28), clear the bed, and check that the accelerometers answer
; (ACCELEROMETER_QUERY). The nozzle rises to z {z} mm and moves in x and y; nothing is extruded.
; If you cancel it, Klipper keeps this file's acceleration: run FIRMWARE_RESTART.
G90
G1 Z{z} F{lift}
SET_VELOCITY_LIMIT ACCEL={acceleration}
"""


@dataclass(frozen=True, slots=True)
class Run:
    """The strokes of one motor, in the middle of the travel.

    direction: of the path, a unit vector; strokes: (path speed in mm/s, length in mm, to and fro)
    of each recording.
    """

    motor: int
    direction: tuple[float, float]
    middle: tuple[float, float]
    acceleration: float
    strokes: tuple[tuple[float, float, int], ...]

    @property
    def angle(self) -> float:
        """Return the angle of the path to x, from 0 to 180 degrees."""
        x, y = self.direction
        return math.degrees(math.atan2(y, x)) % 180.0

    @property
    def seconds(self) -> float:
        """Return the time that it takes, without the recordings' files."""
        return sum(
            2 * times * (length / speed + speed / self.acceleration) + 1e-3 * SETTLED
            for speed, length, times in self.strokes
        )


def runs(printer: Printer) -> list[Run]:
    """Return the strokes of both motors. Raises PrinterError, and LimitError without room."""
    check_records(printer)
    inverse = np.linalg.inv(printer.kinematics.matrix)
    return [_run(printer, motor, inverse[:, motor]) for motor in (0, 1)]


def _run(printer: Printer, motor: int, way: np.ndarray) -> Run:
    x, y = (way / np.linalg.norm(way)).tolist()
    if (y, x) < (0.0, 0.0):
        x, y = -x, -y
    travel = printer.travel
    middle = (sum(travel.x) / 2.0, sum(travel.y) / 2.0)
    rooms = (room(printer, axis, middle) - MARGIN for axis in (0, 1))
    reach = min(
        left / abs(part) for left, part in zip(rooms, (x, y), strict=True) if abs(part) > 1e-9
    )
    limits = printer.limits
    acceleration = min(GENTLE, limits.acceleration)
    strokes = list[tuple[float, float, int]]()
    for speed in np.arange(SLOWEST, min(FASTEST, limits.velocity) + 1e-9, STEP).tolist():
        # Klipper reaches a speed only if it is kept for half the way (minimum_cruise_ratio)
        needed = speed * STROKE / 2.0 + 2.0 * speed**2 / acceleration
        if needed > 2.0 * reach:
            break
        length = min(max(speed * STROKE, needed, SHORTEST), 2.0 * reach)
        strokes.append((speed, length, math.ceil(RECORDED / (2.0 * length / speed))))
    if not strokes:
        raise LimitError("room for strokes (mm)", 2.0 * reach, SHORTEST, None, "check [travel]")
    return Run(motor, (x, y), middle, acceleration, tuple(strokes))


def gcode(
    printer: Printer, planned: Sequence[Run], chips: Sequence[str], z: float
) -> Iterator[bytes]:
    """Yield the G-code of runs. chips: as Klipper names them; empty: those of the profile."""
    table = printer.firmware.klipper
    usual = printer.limits.acceleration if table is None else table.acceleration
    stamp = f"{STAMP.decode()} {__version__}, printer {printer.name}, settings {printer.digest}\n"
    yield stamp.encode() + HEAD.format(
        printer=printer.name, version=__version__, z=plain(z, 3), lift=plain(60.0 * LIFT, 1),
        runs=sum(len(run.strokes) for run in planned), total=duration(seconds_of(planned)),
        acceleration=plain(planned[0].acceleration, 1),
    ).encode()  # fmt: skip
    for run in planned:
        for stroke in run.strokes:
            yield "\n".join([*_recording(printer, run, stroke, chips), ""]).encode()
    yield f"SET_VELOCITY_LIMIT ACCEL={plain(usual, 1)}\n".encode()


def _recording(
    printer: Printer, run: Run, stroke: tuple[float, float, int], chips: Sequence[str]
) -> Iterator[str]:
    speed, length, times = stroke
    there, back = (
        " ".join(
            f"{name}{plain(at + sign * part * length / 2.0, 3)}"
            for name, at, part in zip("XY", run.middle, run.direction, strict=True)
        )
        for sign in (1.0, -1.0)
    )
    sensors = chips or sensors_of(printer, run)
    name = f"vib_an{run.angle:.2f}sp{speed:.2f}".replace(".", "_")
    yield f"G1 {back} F{plain(60.0 * APPROACH, 1)}"
    yield from ("M400", f"G4 P{SETTLED}")
    yield from (f"ACCELEROMETER_MEASURE CHIP={chip}" for chip in sensors)
    for _ in range(times):
        yield f"G1 {there} F{plain(60.0 * speed, 1)}"
        yield f"G1 {back}"
    yield "M400"
    yield from (f"ACCELEROMETER_MEASURE CHIP={chip} NAME={name}" for chip in sensors)


def sensors_of(printer: Printer, run: Run) -> tuple[str, ...]:
    """Return the profile's accelerometers of the axes that a run moves."""
    known = (printer.sweep.chip_x, printer.sweep.chip_y)
    found = [chip for chip, part in zip(known, run.direction, strict=True) if chip and part]
    return tuple(dict.fromkeys(found)) or (USUAL_CHIP,)


def seconds_of(planned: Sequence[Run]) -> float:
    """Return the time of all runs."""
    return sum(run.seconds for run in planned)
