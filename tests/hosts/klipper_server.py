"""The real Klipper host without hardware, with its API socket, for Moonraker.

Run as ``python -m tests.hosts.klipper_server KLIPPY_ARGUMENT...``. In batch mode klippy opens no
socket and ends with its input; here it opens one and stays.
"""

import importlib
import sys
from typing import Any

from tests.hosts.accelerometer import answer_with_a_machine
from tests.klipper.batch import compile_helper, record_moves


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
