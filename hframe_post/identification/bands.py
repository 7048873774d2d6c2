"""Bands of motor speed that shake the nozzle, from Shake&Tune's CREATE_VIBRATIONS_PROFILE.

Shake&Tune records each speed by itself, in strokes in directions in which only one motor turns, and
names the recording by both: ``vib_an45_00sp120_00``, 45° and 120 mm/s.

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
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal

from hframe_post.arrays import Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import Recording
from hframe_post.identification.recordings.folder import Aside, Measurement, read_files
from hframe_post.model.kinematics import Kinematics

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
    for one in read_files(paths, unusable={})[1]:
        if not isinstance(one, Measurement):
            aside.append(one)
            continue
        if (named := LABEL.search(one.label)) is None:
            reason = "its name does not say angle and speed, as an45_00sp120_00"
            aside.append(Aside(one.label, reason))
            continue
        angle, speed = (float(f"{named[k]}.{named[k + 1]}") for k in (1, 3))
        direction = np.array([[math.cos(math.radians(angle))], [math.sin(math.radians(angle))]])
        belts = speed * np.abs(kinematics.belts(*direction)[:, 0])
        turning = np.flatnonzero(belts > STANDS * speed)
        if len(turning) != 1:
            aside.append(Aside(one.label, f"both motors turn at {angle:g}°"))
            continue
        motor = int(turning[0])
        energies[motor][round(float(belts[motor]), 3)].append(
            _energy(one.recording, float(belts[motor]))
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
        f"Record them with CREATE_VIBRATIONS_PROFILE of Shake&Tune{why}"
    )


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
WIDEST_LOG = 0.5 * math.log(WIDEST)
FAINT = 0.3  # of the strongest excess; fainter ones are noise
LEAST = 1e-3  # mm; noise of an ADXL345 looks like less
MAIN = 0.5  # of all shaking at a speed, from which one ripple is its cause
SLOWEST = 20.0  # mm/s at the belt
MOST = 4  # bands of a motor


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
    """Return the bands of a motor that shake most above the usual, by speed."""
    speed = np.arange(shaking.speed[0], shaking.speed[-1] + STEP / 2.0, STEP)
    *ripples, rms = (
        np.interp(speed, shaking.speed, each) for each in (*shaking.ripples.T, shaking.rms)
    )
    more = (speed >= SLOWEST) & (rms > EDGE * _usual(speed, rms))
    found = list[Band]()
    for ripple in ripples:
        usual = _usual(speed, ripple)
        free = more & (ripple > np.maximum(MAIN * rms, LEAST))
        edge = np.diff((ripple > EDGE * usual).astype(np.int8), prepend=0, append=0)
        of_ripple = list[Band]()
        for low, high in zip(np.flatnonzero(edge > 0), np.flatnonzero(edge < 0), strict=True):
            if free[low:high].any():
                k = low + int(np.argmax(np.where(free, ripple - usual, 0.0)[low:high]))
                near = speed[low:high][np.abs(np.log(speed[low:high] / speed[k])) < WIDEST_LOG]
                here = (float(v) for v in (near[0], near[-1], speed[k], ripple[k], usual[k]))
                of_ripple.append(Band(shaking.motor, *here))
        # what exceeds a fainter peak, but hardly its own usual, shows that both are chance
        of_ripple.sort(key=lambda band: band.usual - band.rms)
        found += takewhile(lambda band: band.rms > PEAK * band.usual, of_ripple)
    found.sort(key=lambda band: band.usual - band.rms)
    kept = list[Band]()
    for band in found[:MOST]:
        apart = not any(one.least <= band.worst <= one.greatest for one in kept)
        if apart and band.rms - band.usual >= FAINT * (found[0].rms - found[0].usual):
            kept.append(band)
    return sorted(kept, key=lambda band: band.least)


def _usual(speed: Array, rms: Array) -> Array:
    """Return the median (n,) at the speeds around each speed (n,)."""
    return np.array([np.median(rms[np.abs(np.log(speed / s)) <= math.log(AROUND)]) for s in speed])


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
