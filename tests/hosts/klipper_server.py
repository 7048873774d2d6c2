"""The real Klipper host without hardware, with its API socket, for Moonraker.

Run as ``python -m tests.hosts.klipper_server KLIPPY_ARGUMENT...``. In batch mode klippy opens no
socket and ends with its input; here it opens one and stays.

A section [adxl345] answers with the motion of a simulated printer, along the moves in the host's
queue. It is described in the file that the option ``machine`` names, as JSON, and read for each
recording: {"kinematics": "corexy", "x": [Hz, damping], "y": [Hz, damping]}. Without the file the
sensor does not answer.
"""

import importlib
import json
import sys
import tempfile
from array import array
from pathlib import Path
from typing import Any

import numpy as np

from hframe_post.arrays import TS, Array
from tests.klipper.batch import Sensed, compile_helper, record_moves, stand_in_for_accelerometers
from tests.klipper.host import MOVE, evaluated
from tests.simulator import RATE, Axis, Chip, Machine, Mode

SETTLE = 1.0  # s before and after a recording, from which on the printer is simulated


def machine_of(path: Path) -> Machine:
    """Return the printer that a file describes."""
    found = json.loads(path.read_text())
    x, y = (Axis((Mode(*found[axis]),)) for axis in "xy")
    return Machine(x, y, 0.0, kinematics=found["kinematics"])


def answer_with_a_machine(module: Any, moves: "array[float]") -> None:
    """Let klippy's ``adxl345`` record a simulated printer. moves: numbers of the motion queue."""

    def sensor(config: Any) -> Sensed:
        path = Path(config.get("machine"))

        def sensed(first: float, last: float) -> list[Any] | None:
            if path.exists():
                return list(recorded(machine_of(path), moves, first, last).tolist())
            return None

        return sensed

    stand_in_for_accelerometers(module, Path(tempfile.gettempdir()), sensor)


def recorded(machine: Machine, moves: "array[float]", first: float, last: float) -> Array:
    """Return time and acceleration (n, 4) between two print times, s and mm/s²."""
    begin = first - SETTLE
    t = begin + TS * np.arange(int((last - first + 2.0 * SETTLE) / TS))
    chip, command = Chip(), evaluated(np.frombuffer(moves.tobytes(), MOVE), t)[:, :2]
    motion, rng = machine.played(command, 1), np.random.default_rng(len(moves))
    times = begin + np.arange(0.0, len(motion) / RATE, 1.0 / chip.rate)
    grid = begin + np.arange(len(motion)) / RATE
    a = np.column_stack([np.interp(times, grid, motion[:, k]) for k in (2, 3)] + [0.0 * times])
    a += rng.normal(0.0, chip.noise * np.sqrt(chip.rate / 2.0), a.shape)
    a[:, 2] += 9806.65
    return np.column_stack([times, np.round(a / chip.step) * chip.step])


def main() -> None:
    """Run klippy as the command line says."""
    sys.argv = ["klippy", *sys.argv[1:]]
    compile_helper()
    gcode: Any = importlib.import_module("klippy.gcode")
    server: Any = importlib.import_module("klippy.webhooks").ServerSocket
    open_socket, add_objects = server.__init__, gcode.add_early_printer_objects

    def open_as_on_a_printer(self: Any, webhooks: Any, printer: Any) -> None:
        arguments = printer.get_start_args()
        batch = arguments.pop("debuginput")
        open_socket(self, webhooks, printer)
        arguments["debuginput"] = batch

    def answering_errors(printer: Any) -> None:
        add_objects(printer)
        printer.lookup_object("gcode").is_fileinput = False

    moves = record_moves(importlib.import_module("klippy.toolhead").ToolHead)
    answer_with_a_machine(importlib.import_module("klippy.extras.adxl345"), moves)
    server.__init__ = open_as_on_a_printer
    gcode.add_early_printer_objects = answering_errors
    gcode.GCodeIO._handle_ready = lambda _: None  # nothing is read, so it does not end
    importlib.import_module("klippy.printer").main()


if __name__ == "__main__":
    main()
