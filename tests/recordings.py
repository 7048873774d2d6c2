"""Sweeps, and files of recordings."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.identification.recordings.accelerometer import GRAVITY, Recording, from_table
from hframe_post.identification.recordings.formats import read_tables, unpacked

# printer.cfg of the Sovol SV08 whose recordings are among the tests
SV08_CONFIG = """
[printer]
kinematics: corexy
max_velocity: 500
max_accel: 20000
[stepper_x]
position_max: 350
[stepper_y]
position_max: 360
[extruder]
nozzle_diameter: 0.4
[resonance_tester]
accel_chip: adxl345
probe_points: 175, 175, 30
accel_per_hz: 90
"""
SIXTEEN_BITS, THIRTEEN_BITS = (2 * 16 * GRAVITY / 2**bits for bits in (16, 13))


def sweep(rate: float = 4.0, marks: bool = True, low: float = 2.0, high: float = 120.0) -> Array:
    """Return displacements (m,), mm every 1 ms: quiet, mark, quiet, sweep, quiet, mark, quiet."""
    quiet = np.zeros(1000)
    mark = chirp(10.0, 100.0, 401, 100)
    samples = round((high - low) / rate / TS) + 1
    whole = chirp(low, high, samples, 500)
    whole += fading(samples, 500) * np.sin(np.pi * np.arange(samples) * TS)  # a slow sway
    parts = [quiet, mark, quiet, whole, quiet, mark, quiet] if marks else [quiet, whole, quiet]
    return np.concatenate(parts)


def chirp(low: float, high: float, n: int, edge: int) -> Array:
    """Return a chirp of 3000 mm/s², or less where that would move more than 5 mm."""
    t = np.arange(n) * TS
    rate = (high - low) / t[-1]
    omega = 2.0 * np.pi * (low + rate * t)
    size = 1.0 / (omega**2 / 3000.0 + 1.0 / 5.0)
    return np.asarray(fading(n, edge) * size * np.sin(2.0 * np.pi * (low + rate * t / 2.0) * t))


def fading(n: int, edge: int) -> Array:
    u = np.clip(np.minimum(np.arange(n), np.arange(n)[::-1]) / edge, 0.0, 1.0)
    return np.asarray(u**3 * (10.0 - u * (15.0 - 6.0 * u)))


def read(path: Path, columns: Sequence[str] | None = None) -> Recording:
    """Return the one recording in a file."""
    (table,) = read_tables(path, unpacked(path), columns)
    return from_table(path, table)


def write_klipper(path: Path, recording: Recording) -> Path:
    """Write Klipper's raw accelerometer file."""
    rows = np.column_stack([recording.t, recording.a])
    np.savetxt(path, rows, "%.6f", ",", header="time,accel_x,accel_y,accel_z", comments="#")
    return path
