"""A section [adxl345] of the Klipper host that answers with a simulated printer's motion.

The printer plays what the host has planned, along the moves in its motion queue. It is described in
the file that the option ``machine`` names, as JSON, and read for each recording: {"kinematics":
"corexy", "x": [Hz, damping], "y": [Hz, damping]}. Without the file the sensor does not answer.
"""

from __future__ import annotations

import json
import tempfile
from array import array
from pathlib import Path
from typing import Any

import numpy as np

from hframe_post.arrays import TS, Array
from tests.klipper.batch import Sensed, stand_in_for_accelerometers
from tests.klipper.host import MOVE, evaluated
from tests.simulator import RATE, Axis, Chip, Machine, Mode

SETTLE = 1.0  # s before and after a recording, from which on the printer is simulated


def machine_of(path: Path) -> Machine:
    """Return the printer that a file describes."""
    found = json.loads(path.read_text())
    x, y = (Axis((Mode(*found[axis]),)) for axis in "xy")
    return Machine(x, y, 0.0, kinematics=found["kinematics"])


def answer_with_a_machine(module: Any, moves: array[float]) -> None:
    """Let klippy's ``adxl345`` record a simulated printer. moves: numbers of the motion queue."""

    def sensor(config: Any) -> Sensed:
        path = Path(config.get("machine"))

        def sensed(first: float, last: float) -> list[Any] | None:
            if path.exists():
                return list(recorded(machine_of(path), moves, first, last).tolist())
            return None

        return sensed

    stand_in_for_accelerometers(module, Path(tempfile.gettempdir()), sensor)


def recorded(machine: Machine, moves: array[float], first: float, last: float) -> Array:
    """Return time and acceleration (n, 4) between two print times, s and mm/s²."""
    begin = first - SETTLE
    t = begin + TS * np.arange(int((last - first + 2.0 * SETTLE) / TS))
    planned = np.frombuffer(moves.tobytes(), MOVE)
    chip, command = Chip(), evaluated(planned, t)[:, :2]
    motion = machine.played(command, 1)
    rng = np.random.default_rng(len(moves))
    times = begin + np.arange(0.0, len(motion) / RATE, 1.0 / chip.rate)
    grid = begin + np.arange(len(motion)) / RATE
    a = np.column_stack([np.interp(times, grid, motion[:, k]) for k in (2, 3)] + [0.0 * times])
    a += rng.normal(0.0, chip.noise * np.sqrt(chip.rate / 2.0), a.shape)
    a[:, 2] += 9806.65
    return np.column_stack([times, np.round(a / chip.step) * chip.step])
