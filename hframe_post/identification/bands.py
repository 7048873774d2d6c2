"""Bands of motor speed that shake the nozzle: the strokes that show them, and what these say.

Klipper records each speed by itself, in a file named as Shake&Tune names it:
``vib_an45_00sp120_00``, 45° and 120 mm/s. The strokes are plain moves in directions in which only
one motor turns, so that nothing but that motor shakes the nozzle between the turns.

A motor's torque ripples with its phase: once per 0.8 mm of a GT2 belt on 20 teeth, and at
multiples; the belt meshes once per 2 mm. So the nozzle shakes where one of these meets a resonance.
Only these frequencies count, each by itself: on a Voron 4 to 5 µm that do not follow the motor
would hide them, and 5.9 µm at one of them, 2.6 at speeds nearby, are 6.4 and 4.5 in all.
What a wall shows is the way, not the acceleration. So the acceleration's spectrum is divided by ω⁴.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal

from hframe_post.arrays import Array, Flags
from hframe_post.errors import HframeError, IdentificationError, LimitError
from hframe_post.firmware.code import plain
from hframe_post.gcode.commands import STAMP
from hframe_post.identification.recordings.accelerometer import Recording, from_table
from hframe_post.identification.recordings.folder import Aside, files_in, reason_of
from hframe_post.identification.recordings.formats import read_tables, unpacked
from hframe_post.identification.recordings.runs import APPROACH, LIFT, check_records, room
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.firmware_tables import USUAL_CHIP
from hframe_post.printer.settings import Printer
from hframe_post.version import __version__
from hframe_post.writers.print_time import duration

LABEL = re.compile(r"an(\d+)_(\d+)sp(\d+)_(\d+)", re.IGNORECASE)
WINDOW = 0.25  # s of a spectrum; a stroke at full speed lasts longer
LOWEST, HIGHEST = 15.0, 400.0  # Hz
# mm of belt: a tooth of GT2; four, two and one full steps of 1.8° on 20 teeth
PERIODS = np.array([2.0, 0.8, 0.4, 0.2])
NEAR = 1.5  # bins of a spectrum by which a frequency may be off: a Hann window's half width
QUIETEST = 0.25  # quantile of the windows: the rest is where the head turns, and rings from it
STANDS = 0.05  # share of the path's speed at which a motor counts as standing
LEAST_SPEEDS = 10  # of a motor


@dataclass(frozen=True, slots=True)
class MotorShaking:
    """Shaking of the nozzle by one motor: speeds (k,) at the belt, rising, mm/s.

    motor: 0 for A, 1 for B. angle: of the strokes, degrees. ripples (k, 4): RMS in mm at the
    frequency of each of PERIODS.
    """

    motor: int
    angle: float
    speed: Array
    ripples: Array

    @property
    def rms(self) -> Array:
        """Return the RMS (k,) of all of them together, mm."""
        return np.asarray(np.linalg.norm(self.ripples, axis=1))


def shaking(
    paths: Sequence[Path], kinematics: Kinematics
) -> tuple[list[MotorShaking], list[Aside]]:
    """Return the shaking by each motor, and the recordings that do not show one.

    Raises OSError, and IdentificationError if no motor has enough speeds.
    """
    energies: dict[int, dict[float, list[Array]]] = defaultdict(lambda: defaultdict(list))
    angles, aside = dict[int, float](), list[Aside]()
    for label, name, recording in _recordings(paths, aside):
        if (named := LABEL.search(name)) is None:
            aside.append(Aside(label, "its name does not say angle and speed, as an45_00sp120_00"))
            continue
        angle, speed = (float(f"{named[k]}.{named[k + 1]}") for k in (1, 3))
        direction = np.array([[math.cos(math.radians(angle))], [math.sin(math.radians(angle))]])
        belts = speed * np.abs(kinematics.belts(*direction)[:, 0])
        turning = np.flatnonzero(belts > STANDS * speed)
        if len(turning) != 1:
            aside.append(Aside(label, f"both motors turn at {angle:g}°"))
            continue
        motor = int(turning[0])
        energies[motor][round(float(belts[motor]), 3)].append(
            _energy(recording, float(belts[motor]))
        )
        angles[motor] = angle
    found = [
        MotorShaking(
            motor,
            angles[motor],
            np.array(speeds),
            np.sqrt([np.mean(by[s], axis=0) for s in speeds]),
        )
        for motor, by in sorted(energies.items())
        if len(speeds := sorted(by)) >= LEAST_SPEEDS
    ]
    if not found:
        raise IdentificationError(_nothing(paths, energies, aside))
    return found, aside


def _nothing(
    paths: Sequence[Path], energies: dict[int, dict[float, list[Array]]], aside: list[Aside]
) -> str:
    most = max((len(by) for by in energies.values()), default=0)
    why = f". Not used: {aside[0].label}: {aside[0].reason}" if aside else ""
    return (
        f"{', '.join(map(str, paths))}: {most} speeds of a motor, and {LEAST_SPEEDS} are needed. "
        "Record what 'hframe-post measure --for bands' writes, or CREATE_VIBRATIONS_PROFILE of "
        "Shake&Tune"
        f"{why}"
    )


def _recordings(paths: Sequence[Path], aside: list[Aside]) -> Iterator[tuple[str, str, Recording]]:
    """Yield a label, the name and the recording of each; what cannot be read is put aside."""
    for path, label in files_in(paths).items():
        try:
            tables = read_tables(path, unpacked(path), None)
        except HframeError as error:
            aside.append(Aside(label, reason_of(path, error)))
            continue
        for table in tables:
            name = table.name or path.name
            which = f"{label}: {name}" if table.name else label
            try:
                yield which, name, from_table(path, table)
            except HframeError as error:
                aside.append(Aside(which, reason_of(path, error)))


def _energy(recording: Recording, speed: float) -> Array:
    """Return mean squares (4,) of the nozzle's way, mm², that follow a belt at constant mm/s."""
    rate = 1.0 / recording.period
    n = min(round(WINDOW * rate), len(recording.t))
    f, _, spectra = signal.spectrogram(
        recording.a.T, rate, "hann", n, round(0.75 * n), detrend="constant"
    )
    band = np.abs(f - speed / PERIODS[:, None]) <= NEAR * (f[1] - f[0])
    band &= (f >= LOWEST) & (f <= HIGHEST)
    power = spectra.sum(axis=0) / (2.0 * np.pi * np.maximum(f, LOWEST)[:, None]) ** 4
    return np.asarray(np.quantile((band @ power) * (f[1] - f[0]), QUIETEST, axis=1))


STEP = 0.5  # mm/s, between speeds
AROUND = 1.6  # factor on the speed, up and down, within which the usual shaking is the median
PEAK, EDGE = 1.5, 1.25  # times the usual shaking: at the worst speed of a band, at its ends
WIDEST = 1.45  # greatest over least speed of a band; what is wider cannot be avoided
FAINT = 0.3  # of the strongest peak; fainter ones do not count
LEAST = 1e-3  # mm; noise of an ADXL345 looks like less
MAIN = 0.5  # of all shaking at a speed, from which one ripple is its cause
SLOWEST = 20.0  # mm/s at the belt
MOST = 4  # bands of a motor
TINY = 1e-9  # mm


@dataclass(frozen=True, slots=True)
class Band:
    """Speeds of a motor from least to greatest, mm/s at the belt.

    worst: the speed in it that shakes most. rms, usual: by the ripple that meets a resonance, there
    and at speeds around, mm.
    """

    motor: int
    least: float
    greatest: float
    worst: float
    rms: float
    usual: float


def bands(motors: Iterable[MotorShaking]) -> list[Band]:
    """Return the bands of all motors, by motor and speed."""
    return [band for motor in motors for band in _of_motor(motor)]


def to_avoid(found: Sequence[Band]) -> tuple[tuple[int, int], ...]:
    """Return the bands that a profile avoids, for both motors: whole mm/s, those that meet joined.

    Two that would become wider than WIDEST when joined stay apart by 1 mm/s.
    """
    joined = list[tuple[int, int]]()
    for band in sorted(found, key=lambda one: one.least):
        least, greatest = math.floor(band.least), math.ceil(band.greatest)
        if joined and least <= joined[-1][1]:
            low, high = joined[-1]
            if max(greatest, high) <= WIDEST * low:
                joined[-1] = (low, max(greatest, high))
                continue
            least = high + 1
            if greatest <= least:
                continue
        joined.append((least, greatest))
    return tuple(joined)


def _of_motor(shaking: MotorShaking) -> list[Band]:
    speed = np.arange(shaking.speed[0], shaking.speed[-1] + STEP / 2.0, STEP)
    around = [(speed >= s / AROUND) & (speed <= s * AROUND) for s in speed]
    *ripples, rms = (
        np.interp(speed, shaking.speed, each) for each in (*shaking.ripples.T, shaking.rms)
    )
    more = (speed >= SLOWEST) & (rms > EDGE * _median(rms, around))
    found = list[Band]()
    for ripple in ripples:
        usual = _median(ripple, around)
        free = more & (ripple > np.maximum(MAIN * rms, LEAST))
        found += _of_ripple(shaking.motor, speed, ripple, usual, free)
    found.sort(key=lambda band: band.usual - band.rms)
    kept = list[Band]()
    for band in found[:MOST]:
        apart = not any(one.least <= band.worst <= one.greatest for one in kept)
        if apart and band.rms - band.usual >= FAINT * (found[0].rms - found[0].usual):
            kept.append(band)
    return sorted(kept, key=lambda band: band.least)


def _median(rms: Array, around: Sequence[Flags]) -> Array:
    return np.array([np.median(rms[near]) for near in around])


def _of_ripple(motor: int, speed: Array, rms: Array, usual: Array, free: Flags) -> Iterator[Band]:
    """Yield the bands of one ripple. free (n,): where they may have their worst speed."""
    over = rms / np.maximum(usual, TINY)
    while free.any():
        k = int(np.flatnonzero(free)[np.argmax((rms - usual)[free])])
        if over[k] < PEAK:
            return
        low, high = _edges(speed, over, k)
        free[low : high + 1] = False
        here = (float(value) for value in (*speed[[low, high, k]], rms[k], usual[k]))
        yield Band(motor, *here)


def _edges(speed: Array, over: Array, peak: int) -> tuple[int, int]:
    """Return where a band around its worst speed begins and ends.

    It grows to the side that shakes more, until both shake little more than usual or it is WIDEST.
    """
    low = high = peak
    while True:
        below = over[low - 1] if low else 0.0
        above = over[high + 1] if high + 1 < len(over) else 0.0
        if max(below, above) < EDGE:
            return low, high
        low, high = (low - 1, high) if below > above else (low, high + 1)
        if speed[high] > WIDEST * speed[low]:
            return (low + 1, high) if below > above else (low, high - 1)


LEAST_SPEED, MOST_SPEED, SPEED_STEP = 10.0, 200.0, 2.0  # mm/s of the path
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
    for speed in np.arange(
        LEAST_SPEED, min(MOST_SPEED, limits.velocity) + 1e-9, SPEED_STEP
    ).tolist():
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


MICRON = 1e3
MOTORS = "AB"


@dataclass(frozen=True, slots=True)
class BandsReport:
    """The shaking by each motor, its bands, and those that a profile avoids."""

    motors: tuple[MotorShaking, ...]
    found: tuple[Band, ...]
    avoid: tuple[tuple[int, int], ...]

    @classmethod
    def from_motors(cls, motors: Sequence[MotorShaking]) -> BandsReport:
        found = bands(motors)
        return cls(tuple(motors), tuple(found), to_avoid(found))

    def as_text(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        for motor in self.motors:
            slowest, fastest = motor.speed[[0, -1]]
            yield (
                f"motor {MOTORS[motor.motor]}   {len(motor.speed)} speeds of {slowest:.0f} to "
                f"{fastest:.0f} mm/s at the belt, strokes at {motor.angle:.0f}°"
            )
            of_motor = [band for band in self.found if band.motor == motor.motor]
            for band in of_motor:
                yield (
                    f"          {band.least:.0f} to {band.greatest:.0f} mm/s: the nozzle shakes by "
                    f"{MICRON * band.rms:.1f} µm RMS at {band.worst:.0f} mm/s, by "
                    f"{MICRON * band.usual:.1f} at other speeds nearby"
                )
            if not of_motor:
                yield "          no speed shakes the nozzle much more than those around it"
        shown = ", ".join(f"[{least}, {greatest}]" for least, greatest in self.avoid)
        yield f"avoid     [{shown}]" if shown else "avoid     nothing"

    def as_json(self) -> dict[str, Any]:
        return {
            "avoid": [list(band) for band in self.avoid],
            "bands": [
                {"motor": MOTORS[band.motor]}
                | {name: round(value, 6) for name, value in asdict(band).items() if name != "motor"}
                for band in self.found
            ],
            "motors": [
                {
                    "motor": MOTORS[motor.motor],
                    "angle": motor.angle,
                    "speed": motor.speed.tolist(),
                    "rms": [round(value, 6) for value in motor.rms.tolist()],
                }
                for motor in self.motors
            ],
        }
