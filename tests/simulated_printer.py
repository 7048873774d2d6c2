"""A printer with accelerometers that does not exist: plays a command, writes what Klipper would.

The nozzle moves as eq. 1 and 2 say; an end of the bridge, at x = x_P, moves in y only, by
y' + (x_P − x_c) θ. Between the 1 ms samples of the plant the motion is a quintic spline,
whose second derivative the sensor sees at its own, uneven times.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from hframe_post.arrays import Array
from hframe_post.plant import Plant
from hframe_post.simulate import Response
from hframe_post.stream import TS

GRAVITY = 9806.65  # mm/s²
RATE = 3200.0  # samples a second


@dataclass(frozen=True)
class Sensor:
    """An accelerometer and its faults.

    at: None on the nozzle, else the x (mm) of its place on the bridge. turned: degrees about
    z, then y, then x. noise: mm/s²/√Hz. full_scale: mm/s² at the ends of ``bits``. drift:
    how much its clock runs fast. started: the clock when the command begins, s.
    """

    at: float | None = None
    turned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise: float = 3.0
    bits: int = 16
    full_scale: float = 16 * GRAVITY
    drift: float = 0.005
    started: float = 1234.5
    jitter: float = 2e-6
    offset: tuple[float, float, float] = field(default=(120.0, -80.0, 250.0))

    def turn(self) -> Rotation:
        return Rotation.from_euler("ZYX", self.turned, degrees=True)


def moved(plant: Plant, command: Array, at: float | None) -> Array:
    """Where the sensor is, (m, 2) mm, while the printer plays ``command`` (m, 2)."""
    motion = Response(plant, command[0]).motion(command)
    if at is None:
        return motion[:, :2]
    without = Response(Plant(plant.Gxx, plant.Gyy, None, plant.x_c), command[0]).run(command)
    y = without[:, 1] + (at - plant.x_c) * motion[:, 2]
    return np.column_stack([np.zeros(len(y)), y])


def recorded(plant: Plant, command: Array, sensor: Sensor, seed: int) -> tuple[Array, Array]:
    """Times (n,) s of the sensor's clock and what it shows, (n, 3) mm/s²."""
    rng = np.random.default_rng(seed)
    spline = make_interp_spline(np.arange(len(command)) * TS, moved(plant, command, sensor.at), 5)
    end = (len(command) - 1) * TS
    true = np.arange(rng.uniform(0.0, 1.0 / RATE), end, 1.0 / (RATE * (1.0 + sensor.drift)))
    true = np.clip(true + rng.normal(0.0, sensor.jitter, len(true)), 0.0, end)
    shown = np.zeros((len(true), 3))
    shown[:, :2] = spline.derivative(2)(true)
    shown[:, 2] += GRAVITY
    shown = sensor.turn().inv().apply(shown) + sensor.offset
    shown += rng.normal(0.0, sensor.noise * np.sqrt(RATE / 2.0), shown.shape)
    step = 2.0 * sensor.full_scale / 2**sensor.bits
    shown = np.clip(np.round(shown / step) * step, -sensor.full_scale, sensor.full_scale - step)
    return sensor.started + true * (1.0 + sensor.drift), shown


def write_klipper(path: Path, t: Array, shown: Array) -> Path:
    """Klipper's raw accelerometer file."""
    rows = np.column_stack([t, shown])
    np.savetxt(path, rows, "%.6f", ",", header="time,accel_x,accel_y,accel_z", comments="#")
    return path
