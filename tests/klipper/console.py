"""Type at the console of the real Klipper host while it prints from its virtual SD card.

``typed`` is for tests. It runs this module as a program, which starts klippy in batch mode and
types once it is ready.
"""

import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.klipper.batch import compile_helper, dictionary, klippy_main, klippy_module
from tests.klipper.host import TEMPLATE, run_klippy

PATIENCE_S = 30.0
LIMITS = ("max_velocity", "max_accel", "square_corner_velocity", "minimum_cruise_ratio")

CONDITIONS: dict[str, Callable[[dict[str, Any]], bool]] = {
    "at once": lambda _: True,
    "in mid-print": lambda reports: reports["virtual_sdcard"]["progress"] > 0.4,
    "stopped": lambda reports: not reports["virtual_sdcard"]["is_active"],
    "unlike a stream": lambda reports: reports["toolhead"]["square_corner_velocity"] != 20.0,
}
"""When a command is typed: what the host reports then."""


def typed(
    script: Sequence[tuple[str, str]], files: Mapping[str, bytes], sections: str, workdir: Path
) -> list[dict[str, Any]]:
    """Type commands at the host's console, and return what ``seen`` shows after each.

    script: a condition and a command each. files: on the card, by name. sections: added to
    ``printer.cfg``. Raises KlippyError if the host stops before the end.
    """
    workdir.mkdir(parents=True, exist_ok=True)
    config, log, messages = (workdir / name for name in ("printer.cfg", "log", "messages.json"))
    for name, content in files.items():
        (workdir / name).write_bytes(content)
    config.write_text(f"{TEMPLATE.read_text()}\n{sections}\n[virtual_sdcard]\npath: {workdir}\n")
    messages.write_text(json.dumps(dictionary()))
    (workdir / "script.json").write_text(json.dumps(script))
    (workdir / "input").touch()
    klippy = [config, "-i", workdir / "input", "-o", workdir / "stream", "-d", messages, "-l", log]
    run_klippy(__name__, workdir, [str(argument) for argument in klippy], log)
    rows: list[dict[str, Any]] = json.loads((workdir / "seen.json").read_text())
    return rows


def seen(printer: Any) -> dict[str, Any]:
    """Return limits, shapers, smoothing of advance, state, heater, variables of NOTE, and place."""
    reports = _reports(printer)
    shaper = printer.lookup_object("input_shaper")
    return {
        "limits": [reports["toolhead"][limit] for limit in LIMITS],
        "shapers": [each.params.shaper_freq for each in shaper.shapers[:2]],
        "averaged": reports["extruder"]["smooth_time"],
        "state": reports["print_stats"]["state"],
        "heater": reports["extruder"]["target"],
        "noted": reports.get("gcode_macro NOTE"),
        "at": printer.lookup_object("toolhead").get_position(),
    }


def _reports(printer: Any) -> dict[str, Any]:
    names = ("virtual_sdcard", "toolhead", "print_stats", "extruder", "gcode_macro NOTE")
    found = {name: printer.lookup_object(name, None) for name in names}
    return {name: each.get_status(0.0) for name, each in found.items() if each}


def _type(printer: Any, folder: Path) -> None:
    gcode, reactor, rows = printer.lookup_object("gcode"), printer.get_reactor(), []
    gcode.is_fileinput = False  # an error is answered, as at a console, and not the end
    for condition, command in json.loads((folder / "script.json").read_text()):
        deadline = time.monotonic() + PATIENCE_S
        while not CONDITIONS[condition](_reports(printer)):
            reactor.pause(reactor.monotonic() + 0.005)
            if time.monotonic() > deadline:
                raise RuntimeError(f"the host was never {condition}: {_reports(printer)}")
        gcode.run_script(command)
        rows.append(seen(printer))
    (folder / "seen.json").write_text(json.dumps(rows))
    gcode.request_restart("exit")


def main() -> None:
    """Run klippy as the command line says; exits with klippy's status if that is not 0."""
    folder = Path(sys.argv[1])
    sys.argv = ["klippy", *sys.argv[2:]]
    compile_helper()
    gcode = klippy_module("gcode")
    add_objects = gcode.add_early_printer_objects

    def add_console(printer: Any) -> None:
        def start() -> None:
            printer.get_reactor().register_callback(lambda _: _type(printer, folder))

        add_objects(printer)
        printer.register_event_handler("klippy:ready", start)

    gcode.add_early_printer_objects = add_console
    gcode.GCodeIO._handle_ready = lambda _: None  # nothing else is read
    klippy_main()


if __name__ == "__main__":
    main()
