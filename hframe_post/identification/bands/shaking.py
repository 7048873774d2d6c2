"""How far the nozzle shakes while one motor turns at a constant speed.

Each recording is of strokes to and fro at one speed, in a direction in which only one motor turns.
Its name says which, as Shake&Tune writes it: ``vib_an45_00sp120_00``, 45° and 120 mm/s.

A motor's torque ripples with its phase: once per 0.8 mm of a GT2 belt on 20 teeth, and at
multiples; the belt meshes once per 2 mm. So the nozzle shakes where one of these meets a resonance.
Only these frequencies count: 4 to 5 µm that do not follow the motor would hide them on a Voron.
What a wall shows is the way, not the acceleration. So the acceleration's spectrum is divided by ω⁴.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import signal

from hframe_post.arrays import Array
from hframe_post.errors import HframeError, IdentificationError
from hframe_post.identification.recordings.accelerometer import Recording, from_table
from hframe_post.identification.recordings.folder import Aside, files_in, reason_of
from hframe_post.identification.recordings.formats import read_tables
from hframe_post.identification.recordings.packed import unpacked
from hframe_post.model.kinematics import Kinematics

LABEL = re.compile(r"an(\d+)_(\d+)sp(\d+)_(\d+)", re.IGNORECASE)
WINDOW = 0.25  # s of a spectrum; a stroke at full speed lasts longer
LOWEST, HIGHEST = 15.0, 400.0  # Hz
# mm of belt: a tooth of GT2; four, two and one full steps of 1.8° on 20 teeth
PERIODS = np.array([2.0, 0.8, 0.4, 0.2])
NEAR = 1.5  # bins of a spectrum by which a frequency may be off: a Hann window's half width
QUIET = 0.25  # quantile of the windows: the rest is where the head turns, and rings from it
STANDS = 0.05  # share of the path's speed at which a motor counts as standing
LEAST_SPEEDS = 10  # of a motor


@dataclass(frozen=True, slots=True)
class MotorShaking:
    """Shaking of the nozzle by one motor: speeds (k,) at the belt, rising, mm/s; RMS (k,), mm.

    motor: 0 for A, 1 for B. angle: of the strokes, degrees.
    """

    motor: int
    angle: float
    speed: Array
    rms: Array


def shaking(
    paths: Sequence[Path], kinematics: Kinematics
) -> tuple[list[MotorShaking], list[Aside]]:
    """Return the shaking by each motor, and the recordings that do not show one.

    Raises OSError, and IdentificationError if no motor has enough speeds.
    """
    energies: dict[int, dict[float, list[float]]] = defaultdict(lambda: defaultdict(list))
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
            motor, angles[motor], np.array(speeds), np.sqrt([np.mean(by[s]) for s in speeds])
        )
        for motor, by in sorted(energies.items())
        if len(speeds := sorted(by)) >= LEAST_SPEEDS
    ]
    if not found:
        raise IdentificationError(_nothing(paths, energies, aside))
    return found, aside


def _nothing(
    paths: Sequence[Path], energies: dict[int, dict[float, list[float]]], aside: list[Aside]
) -> str:
    most = max((len(by) for by in energies.values()), default=0)
    why = f". Not used: {aside[0].label}: {aside[0].reason}" if aside else ""
    return (
        f"{', '.join(map(str, paths))}: {most} speeds of a motor, and {LEAST_SPEEDS} are needed. "
        "Record what 'hframe-post bands --gcode' writes, or CREATE_VIBRATIONS_PROFILE of Shake&Tune"
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


def _energy(recording: Recording, speed: float) -> float:
    """Return the mean square of the nozzle's way, mm², that follows a belt at constant mm/s."""
    rate = 1.0 / recording.period
    n = min(round(WINDOW * rate), len(recording.t))
    f, _, spectra = signal.spectrogram(
        recording.a.T, rate, "hann", n, round(0.75 * n), detrend="constant"
    )
    off = np.abs(f[:, None] - speed / PERIODS).min(axis=1)
    band = (off <= NEAR * (f[1] - f[0])) & (f >= LOWEST) & (f <= HIGHEST)
    way = spectra[:, band].sum(axis=0) / (2.0 * np.pi * f[band, None]) ** 4
    return float(np.quantile(way.sum(axis=0) * (f[1] - f[0]), QUIET))
