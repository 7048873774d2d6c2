"""Sweeps, and their recordings by accelerometers with all their faults.

The nozzle moves as eq. 1 and 2 say. Between the 1 ms samples the motion is a spline, whose second
derivative a sensor samples at its own, uneven times.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from hframe_post.arrays import TS, Array
from hframe_post.identification.recordings.accelerometer import GRAVITY, Recording

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


@dataclass(frozen=True)
class Sensor:
    """An accelerometer. turned: rotation in degrees about z, y, x; lead: s before the command."""

    turned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drift: float = 0.0
    noise: float = 3.0  # mm/s²/√Hz
    step: float = SIXTEEN_BITS
    jitter: float = 2e-6
    rate: float = 3200.0
    lead: float = 0.0
    clock: float = 1234.5
    offset: tuple[float, float, float] = (120.0, -80.0, 250.0)

    def record(self, motion: BSpline, seconds: float, seed: int = 0) -> Recording:
        """Return its recording of a motion: x, y, z in mm as a function of time in s."""
        rng = np.random.default_rng(seed)
        t = np.arange(-self.lead, seconds + self.lead, 1.0 / (self.rate * (1.0 + self.drift)))
        t += rng.uniform(0.0, 1.0 / self.rate) + rng.normal(0.0, self.jitter, len(t))
        playing = (t >= 0.0) & (t <= seconds)
        a = np.where(playing[:, None], motion.derivative(2)(np.clip(t, 0.0, seconds)), 0.0)
        a[:, 2] += GRAVITY
        a = Rotation.from_euler("ZYX", self.turned, degrees=True).inv().apply(a) + self.offset
        a += rng.normal(0.0, 1.0, a.shape) * self.noise * np.sqrt(self.rate / 2.0)
        a = np.round(a / self.step) * self.step
        return Recording(self.clock + t * (1.0 + self.drift), a, self.lead == 0.0)


def spline(x: Array, y: Array) -> BSpline:
    motion = np.column_stack([x, y, np.zeros(len(x))])
    return make_interp_spline(np.arange(len(x)) * TS, motion, 9)


def write_klipper(path: Path, recording: Recording) -> Path:
    """Write Klipper's raw accelerometer file."""
    rows = np.column_stack([recording.t, recording.a])
    np.savetxt(path, rows, "%.6f", ",", header="time,accel_x,accel_y,accel_z", comments="#")
    return path
