"""TEST_RESONANCES on drawn printers, recorded by the sensors that owners have."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hframe_post.arrays import Array
from hframe_post.identification.estimation.measured import Run
from hframe_post.identification.recordings.accelerometer import Recording
from hframe_post.identification.recordings.resonance_search import find
from hframe_post.identification.recordings.resonance_test import ResonanceTest
from tests.random_printers import drawn
from tests.simulator import ADXL345, Chip, Machine

X, Y = (1.0, 0.0), (0.0, 1.0)
BELTS = ((0.5**0.5, 0.5**0.5), (0.5**0.5, -(0.5**0.5)))
START = 1234.5  # s on the sensor's clock at the first moment of the motion
LIS2DW = 0.488 * 9.80665 * 4.0  # mm/s², its least step at 16 g, 14 bits
SENSORS = {
    "adxl345": Chip(step=ADXL345, noise=4.0, rate=3200.0),
    "lis2dw": Chip(step=LIS2DW, noise=1.3, rate=1600.0, filtered=True),
    "lis2dw-394": Chip(step=LIS2DW, noise=1.3, rate=394.0, filtered=True),
}
MOTIONS: dict[str, dict[str, Any]] = {
    "sweeping": {},
    "pulses": {"sweeping_period": 0.0},
    "former pulses": {
        "sweeping_period": 0.0, "around_point": True, "accel_per_hz": 75.0, "max_freq": 400.0 / 3.0,
    },
}  # fmt: skip


@dataclass(frozen=True)
class Recorded:
    """A test and its recording."""

    test: ResonanceTest
    recording: Recording


def klipper(direction: tuple[float, ...] = X, **changes: Any) -> ResonanceTest:
    """Return Klipper's default test with changes."""
    default = ResonanceTest(direction, (140.0, 147.5), 5.0, 135.0, 1.0, 60.0, 400.0, 1.2)
    return replace(default, **changes)


def recorded(
    machine: Machine, test: ResonanceTest, chip: Chip, mounting: int, seed: int
) -> Recorded:
    """Return a recording of the machine that plays the test, begun some tenths of a second early.

    mounting: seed of the way in which the sensor sits; half of the draws are left-handed, as are
    many owners' axes maps.
    """
    rng = np.random.default_rng(mounting)
    axes = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    chip = replace(chip, lead=float(np.random.default_rng(seed).uniform(0.15, 0.6)))
    made = chip.record(machine, test.command(), seed)
    return Recorded(test, Recording(made.t, made.a @ axes.T, False))


def drawn_sensor(seed: int, kind: str) -> Chip:
    """Return a sensor with a clock up to 2 % and gains up to 10 % off, slightly tilted."""
    rng = np.random.default_rng(seed)
    gain = float(rng.uniform(0.9, 1.1))
    gains = gain * rng.uniform(0.98, 1.02, 3)
    tilt = rng.uniform(-3.0, 3.0, 3)
    return replace(
        SENSORS[kind],
        gains=(float(gains[0]), float(gains[1]), float(gains[2])),
        turned=(float(tilt[0]), float(tilt[1]), float(tilt[2])),
        drift=float(rng.uniform(-0.02, 0.02)),
        jitter=1e-5,
    )


def wandering(t: Array, size: float, seed: int = 0) -> Array:
    """Return how late a program's stamps of samples at t (s) are: it follows jumps slowly."""
    jumps = np.random.default_rng(seed).normal(0.0, 1.0, int(t[-1] / 0.5) + 4)
    late = np.interp(t, np.arange(len(jumps)) * 0.5, jumps) * size
    return np.asarray(late - 5.0 * size * np.exp(-t / 1.5))


def linear_printer(seed: int) -> Machine:
    """Return a drawn printer without friction, play or harmonics."""
    return drawn(2 * seed)[0]


def runs_of_tests(
    machine: Machine, chip: Chip, motion: str, seed: int, x: Sequence[float], y: Sequence[float]
) -> list[Run]:
    """Return runs of TEST_RESONANCES at places (mm of x), found in their recordings.

    motion: a key of MOTIONS, while printer.cfg leaves all to Klipper's defaults of today. Each
    run has a clock and a start of its own; the sensor stays as it is mounted.
    """
    rng = np.random.default_rng(seed + 999)
    runs: list[Run] = []
    for direction, places in ((X, x), (Y, y)):
        for place in places:
            point = (place, 147.5)
            test = klipper(direction, **MOTIONS[motion], point=point)
            worn = replace(chip, drift=float(rng.uniform(-0.02, 0.02)))
            it = recorded(machine, test, worn, seed, 1000 * seed + len(runs))
            found = find(it.recording, klipper(direction, point=point))
            name = f"{'xy'[direction == Y]}-{place:g}"
            runs.append(Run(name, found.test.command(), it.recording, found.clock))
    return runs
