"""Sweeps, and files of recordings."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import zstandard

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


def sweep(rate: float = 4.0, low: float = 2.0, high: float = 120.0) -> Array:
    """Return displacements (m,), mm every 1 ms: a sweep between a second of rest and another."""
    samples = round((high - low) / rate / TS) + 1
    swept = chirp(low, high, samples, 500)
    swept += fading(samples, 500) * np.sin(np.pi * np.arange(samples) * TS)  # a slow sway
    return np.pad(swept, 1000)


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


def klipper_csv(rows: Array, head: bytes = b"#time,accel_x,accel_y,accel_z\n") -> bytes:
    """Return time and three accelerations (n, 4) as Klipper writes them."""
    return head + b"".join(b"%.6f,%.6f,%.6f,%.6f\n" % tuple(row) for row in rows.tolist())


def write_klipper(path: Path, recording: Recording) -> Path:
    """Write Klipper's raw accelerometer file."""
    path.write_bytes(klipper_csv(np.column_stack([recording.t, recording.a])))
    return path


def stdata(*measurements: tuple[str, Array]) -> bytes:
    """Return named rows (n, 4) as Shake&Tune writes them."""
    lines = (
        json.dumps({"name": name, "samples": values.tolist()}) + "\n"
        for name, values in measurements
    )
    return zstandard.ZstdCompressor().compress("".join(lines).encode())
