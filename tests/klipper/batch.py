"""Start the Klipper host in batch mode and record the moves it plans.

Run as ``python batch.py FOLDER KLIPPY_ARGUMENT...``: klippy runs with the arguments, and
FOLDER then holds ``toolhead.moves`` and ``extruder.moves``, raw float64 records of the 13
numbers that klippy puts into the motion queue for each move (see ``host.MOVE``).
"""

import fcntl
import importlib
import os
import re
import sys
import time
from array import array
from pathlib import Path
from typing import Any

CLOCK_FREQ = 4_000_000
"""Ticks per second. Intervals wrap at 2^32 ticks, so this lets a motor rest for 1073 s
(at a usual 50 MHz: 86 s, less than a layer), and 0.25 us is still exact enough."""

DRAIN_S = 120.0
EMPTY = re.compile(r" ready_bytes=0 upcoming_bytes=0\b")

COMMANDS = (
    "identify offset=%u count=%c",
    "get_uptime",
    "get_clock",
    "get_config",
    "allocate_oids count=%c",
    "finalize_config crc=%u",
    "config_reset",
    "emergency_stop",
    "clear_shutdown",
    "config_stepper oid=%c step_pin=%c dir_pin=%c invert_step=%c step_pulse_ticks=%u",
    "queue_step oid=%c interval=%u count=%hu add=%hi",
    "set_next_step_dir oid=%c dir=%c",
    "reset_step_clock oid=%c clock=%u",
    "stepper_get_position oid=%c",
    "stepper_stop_on_trigger oid=%c trsync_oid=%c",
    "config_endstop oid=%c pin=%c pull_up=%c",
    "endstop_query_state oid=%c",
    (
        "endstop_home oid=%c clock=%u sample_ticks=%u sample_count=%c rest_ticks=%u"
        " pin_value=%c trsync_oid=%c trigger_reason=%c"
    ),
    "config_trsync oid=%c",
    "trsync_start oid=%c report_clock=%u report_ticks=%u expire_reason=%c",
    "trsync_set_timeout oid=%c clock=%u",
    "trsync_trigger oid=%c reason=%c",
    "config_digital_out oid=%c pin=%u value=%c default_value=%c max_duration=%u",
    "set_digital_out pin=%u value=%c",
    "set_digital_out_pwm_cycle oid=%c cycle_ticks=%u",
    "queue_digital_out oid=%c clock=%u on_ticks=%u",
    "update_digital_out oid=%c value=%c",
    "config_analog_in oid=%c pin=%u",
    (
        "query_analog_in oid=%c clock=%u sample_ticks=%u sample_count=%c rest_ticks=%u"
        " min_value=%hu max_value=%hu range_check_count=%c"
    ),
)
"""Messages to the controller, their ids counting from 1. None holds a byte string, so the
whole stream is a sequence of variable-length integers."""

RESPONSES = (
    "starting",
    "is_shutdown static_string_id=%hu",
    "shutdown clock=%u static_string_id=%hu",
    "stats count=%u sum=%u sumsq=%u",
    "uptime high=%u clock=%u",
    "clock clock=%u",
    "config is_config=%c crc=%u is_shutdown=%c move_count=%hu",
    "stepper_position oid=%c pos=%i",
    "endstop_state oid=%c homing=%c next_clock=%u pin_value=%c",
    "trsync_state oid=%c can_trigger=%c trigger_reason=%c clock=%u",
    "analog_in_state oid=%c next_clock=%u value=%hu",
)


def dictionary() -> dict[str, Any]:
    """Message dictionary of a controller that knows just what klippy needs here.

    A firmware build would supply it; written out, the tests need no build.
    """
    # Identification precedes the dictionary, so the protocol fixes its two ids; klippy has
    # identify_response built in as number 0 and identify as number 1.
    commands = {text: i for i, text in enumerate(COMMANDS, start=1)}
    responses = {text: i for i, text in enumerate(RESPONSES, start=len(COMMANDS) + 1)}
    return {
        "app": "Kalico",
        "version": "handmade",
        "build_versions": "handmade",
        "license": "none",
        "config": {
            "MCU": "handmade",
            "CLOCK_FREQ": CLOCK_FREQ,
            "ADC_MAX": 4095,
            "PWM_MAX": 255,
            "STATS_SUMSQ_BASE": 256,
            "STEPPER_BOTH_EDGE": 1,
            "STEPPER_STEP_BOTH_EDGE": 1,
        },
        "commands": commands,
        "responses": {"identify_response offset=%u data=%.*s": 0} | responses,
        "enumerations": {
            "pin": {"gpio0": [0, 100], "analog0": [200, 8]},
            "static_string_id": {"none": 1},
        },
    }


class WholeFileOs:
    """Stands in for ``os`` in klippy's G-code reader and reads the input in one block.

    klippy reads 4096 bytes at a time. In batch mode, where no clock runs, the end of a block
    can pass for the end of the input and bring the tool to a stop that no printer makes.
    """

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)

    @staticmethod
    def read(fd: int, _size: int) -> bytes:
        """Return the rest of the input, with a last newline, which klippy needs."""
        with open(fd, "rb", closefd=False) as file:
            data = file.read()
        return data if not data or data.endswith(b"\n") else data + b"\n"


def record_moves(owner: Any) -> "array[float]":
    """Let each future instance of klippy's class ``owner`` log its moves to the array returned."""
    moves = array("d")
    original_init = owner.__init__

    def init(self: Any, *args: Any, **kwargs: Any) -> None:
        original_init(self, *args, **kwargs)
        append = self.trapq_append

        def recording_append(queue: Any, *move: float) -> None:
            moves.extend(move)
            append(queue, *move)

        self.trapq_append = recording_append

    owner.__init__ = init
    return moves


def drain_before_exit(reader: Any) -> None:
    """Let klippy's class ``reader`` write all that is queued for the controller, then disconnect.

    A thread of its own writes the queue. On a busy machine it lags behind, and what it has not
    written at the end would be lost: the last steps of a file.
    """
    disconnect = reader.disconnect

    def drain(self: Any) -> None:
        deadline = time.monotonic() + DRAIN_S
        while self.serialqueue is not None and not EMPTY.search(self.stats(0.0)):
            if time.monotonic() > deadline:
                raise RuntimeError(f"klippy's queue is not written: {self.stats(0.0)}")
            time.sleep(0.01)
        disconnect(self)

    reader.disconnect = drain


def play_resonance_tests(module: Any) -> None:
    """Let klippy's ``resonance_tester`` play its tests although no accelerometer answers.

    Kalico limits the speed to that of the pulses, which cripples sweeping: it takes three times
    as long. Klipper allows the speed that the test needs, and so does this.
    """

    def connect(self: Any) -> None:
        self.accel_chips = []

    def suspend_limits(printer: Any, max_accel: float, _: float, input_shaping: int) -> Any:
        return original(printer, max_accel, 1000.0, input_shaping)

    module.ResonanceTester.connect = connect
    original, module.suspend_limits = module.suspend_limits, suspend_limits


def compile_helper() -> None:
    """Have klippy compile its C library now, unless that is done, one process at a time."""
    chelper: Any = importlib.import_module("klippy.chelper")
    # Lock a file that exists: an installed package need not be writable.
    with open(chelper.__file__, "rb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        chelper.get_ffi()


def main() -> None:
    """Run klippy as the command line says; exits with klippy's status if that is not 0."""
    folder = Path(sys.argv[1])
    sys.argv = ["klippy", *sys.argv[2:]]
    compile_helper()
    gcode: Any = importlib.import_module("klippy.gcode")
    gcode.os = WholeFileOs()
    toolhead = record_moves(importlib.import_module("klippy.toolhead").ToolHead)
    extruder = record_moves(importlib.import_module("klippy.kinematics.extruder").PrinterExtruder)
    play_resonance_tests(importlib.import_module("klippy.extras.resonance_tester"))
    drain_before_exit(importlib.import_module("klippy.serialhdl").SerialReader)
    importlib.import_module("klippy.printer").main()
    for name, moves in (("toolhead", toolhead), ("extruder", extruder)):
        (folder / f"{name}.moves").write_bytes(moves.tobytes())


if __name__ == "__main__":
    main()
