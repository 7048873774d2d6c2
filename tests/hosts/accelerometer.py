"""A section [adxl345] of the Klipper host that answers with a simulated printer's motion.

The printer plays what the host has planned, along the moves in its motion queue. It is described in
the file that the option ``machine`` names, as JSON, and read for each recording: {"kinematics":
"corexy", "x": [Hz, damping], "y": [Hz, damping]}. Without the file the sensor does not answer.
"""

from __future__ import annotations

import inspect
import json
from array import array
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from hframe_post.arrays import TS, Array
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

    class Client(module.AccelQueryHelper):  # type: ignore[misc]
        machine = Path()

        def finish_measurements(self) -> None:
            super().finish_measurements()
            first, last = self.request_start_time, self.request_end_time
            if self.machine.exists():
                data = recorded(machine_of(self.machine), moves, first, last)
                self.msgs = [{"data": data.tolist()}]

    class SimulatedChip:
        def __init__(self, config: Any) -> None:
            self.printer, self.machine = config.get_printer(), Path(config.get("machine"))
            module.AccelCommandHelper(config, self)

        def start_internal_client(self) -> Client:
            no_messages = SimpleNamespace(finalize=lambda: None, get_messages=list)
            parameters = inspect.signature(module.AccelQueryHelper).parameters
            client = Client(*(self.printer, no_messages)[: len(parameters)])
            client.machine = self.machine
            return client

    module.ADXL345 = SimulatedChip


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
