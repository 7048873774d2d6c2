"""hframe.cfg in the real host: after a cancel, a pause and an error the printer's limits hold."""

from pathlib import Path
from typing import Any

import pytest

from hframe_post.firmware.klipper.macros import macros
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.printer.settings import Printer
from tests.conftest import few
from tests.gcode_tools import converted, strokes
from tests.klipper.console import typed
from tests.klipper.host import TEMPLATE
from tests.printers import profile_of

pytestmark = pytest.mark.klipper

OWN = {"limits": [250.0, 3000.0, 7.0, 0.25], "shapers": [51.5, 38.0], "averaged": 0.04}
STREAM = {  # of `setup`'s profile
    "limits": [427.79, 7500.0, 20.0, 0.0], "shapers": [0.0, 0.0], "averaged": 0.02,
}  # fmt: skip
PRINTER = """
[printer]
max_velocity: 250
max_accel: 3000
square_corner_velocity: 7
minimum_cruise_ratio: 0.25
[input_shaper]
shaper_freq_x: 51.5
shaper_freq_y: 38
[gcode_macro NOTE]
variable_paused: 0
variable_cancelled: 0
gcode:
    SET_GCODE_VARIABLE MACRO=NOTE VARIABLE={params.OF} VALUE={printer.toolhead.max_accel|int}
"""
CLIENT = """
[virtual_sdcard]
on_error_gcode: CANCEL_PRINT
[pause_resume]
[gcode_macro CANCEL_PRINT]
rename_existing: CANCEL_PRINT_BASE
gcode:
    NOTE OF=cancelled
    TURN_OFF_HEATERS
    CANCEL_PRINT_BASE
[gcode_macro PAUSE]
rename_existing: PAUSE_BASE
gcode:
    PAUSE_BASE
    NOTE OF=paused
    G1 X200 Y200 F9000
[gcode_macro RESUME]
rename_existing: RESUME_BASE
gcode:
    {% if params.FILAMENT|default(1)|int %}
    RESUME_BASE VELOCITY={params.VELOCITY|default(80)}
    {% endif %}
"""
WITHOUT_PAUSE_RESUME = """
[gcode_macro CANCEL_PRINT]
gcode:
    TURN_OFF_HEATERS
    SDCARD_RESET_FILE
[gcode_macro PAUSE]
gcode: M25
[gcode_macro RESUME]
gcode: M24
"""
CLIENTS = {
    "a client's, included before": (CLIENT, "@"),
    "Klipper's own": ("@", ""),
    "a client's, included after": ("@", CLIENT),
    "macros alone": (WITHOUT_PAUSE_RESUME, "@"),
}
PRINT = ("at once", "SDCARD_PRINT_FILE FILENAME=part.gcode")
SCRIPT = [
    PRINT, ("in mid-print", "CANCEL_PRINT"),
    PRINT, ("in mid-print", "PAUSE"), ("at once", "PAUSE"), ("at once", "RESUME"), ("stopped", ""),
    ("at once", "SDCARD_PRINT_FILE FILENAME=error.gcode"), ("stopped", ""), ("unlike a stream", ""),
]  # fmt: skip


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Printer:
    """Return the profile that `setup` makes for this printer."""
    config = tmp_path_factory.mktemp("machine") / "printer.cfg"
    config.write_text(TEMPLATE.read_text() + PRINTER)
    return profile_of(KlipperConfig(config))


@pytest.fixture(scope="module")
def files(machine: Printer) -> dict[str, bytes]:
    """Return a converted print, and the same with an error in mid-stream."""
    lines = [line.encode() + b"\n" for line in ["M104 S200", *strokes(7, 25)]]
    text, _ = converted(lines, machine)
    rows = text.splitlines(keepends=True)
    half = len(rows) // 2
    broken = [*rows[:half], b"G1 X9999\n", *rows[half:]]
    return {"part.gcode": text, "error.gcode": b"".join(broken)}


def sections(client: str, machine: Printer, folder: Path) -> str:
    """Return the configuration with hframe.cfg, which looks ten times as often after errors."""
    before, after = CLIENTS[client]
    config = folder / "own.cfg"
    config.write_text(f"{PRINTER}\n{before}\n{after}".replace("@", ""))
    text = macros(machine, KlipperConfig(config))
    text = text.replace("DURATION=2", "DURATION=.2").replace("duration: 2", "duration: .2")
    return f"{PRINTER}\n{before}\n{after}".replace("@", text)


def like(row: dict[str, Any], expected: dict[str, Any]) -> bool:
    return all(row[key] == expected[key] for key in expected)


def test_a_shaper_that_the_profile_lacks_comes_back(machine: Printer, tmp_path: Path) -> None:
    """printer.cfg was read without the file that has [input_shaper]."""
    copy = tmp_path / "printer.cfg"
    lost = TEMPLATE.read_text().replace("[input_shaper]", "[include conf/*.cfg]")
    copy.write_text(lost + PRINTER.partition("[input_shaper]")[0])
    config = KlipperConfig(copy)
    unaware = profile_of(config)
    assert unaware.firmware.klipper is not None
    assert unaware.firmware.klipper.shaper_freq_x == 0.0
    lines = [line.encode() + b"\n" for line in ["M104 S200", *strokes(7, 25)]]
    text, _ = converted(lines, unaware)
    assert text.count(b"SET_INPUT_SHAPER SHAPER_FREQ_X=0 ") == text.count(b"SET_INPUT_SHAPER")
    script = [PRINT, ("in mid-print", ""), ("stopped", "")]
    host = sections("Klipper's own", machine, tmp_path)
    _, printing, done = typed(script, {"part.gcode": text}, host, tmp_path / "host")
    assert printing["shapers"] == [0.0, 0.0], "Hz, in mid-print"
    assert done["state"] == "complete"
    assert like(done, OWN)


@pytest.mark.parametrize("client", few([*CLIENTS], 2))
def test_limits_and_shapers_are_the_printers_whatever_stops_the_print(
    client: str, machine: Printer, files: dict[str, bytes], tmp_path: Path
) -> None:
    script, has_client = SCRIPT.copy(), CLIENT in CLIENTS[client]
    if has_client:
        script[4:5] = [("at once", "RESUME FILAMENT=0")]  # refused, as with a runout sensor
    rows = typed(script, files, sections(client, machine, tmp_path), tmp_path / "host")
    _, cancelled, _, paused, again, resumed, done, _, failed, later = rows
    assert [like(row, OWN) for row in (cancelled, paused, again, done, later)] == [True] * 5
    assert like(resumed, STREAM)
    assert done["state"] == "complete"
    assert failed["state"] in ("error", "cancelled", "standby")
    if has_client:
        assert cancelled["heater"] == later["heater"] == 0.0
        assert like(failed, OWN)  # at once, by CANCEL_PRINT
        assert paused["noted"]["paused"] == 3000
    if CLIENTS[client][0] is CLIENT:
        assert cancelled["noted"]["cancelled"] == 3000
