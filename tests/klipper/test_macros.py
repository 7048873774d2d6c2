"""hframe.cfg in the real host: after a cancel, a pause and an error the printer's limits hold."""

from pathlib import Path
from typing import Any

import pytest

from hframe_post.firmware.klipper.macros import macros
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.printer.settings import Printer
from tests.conftest import few
from tests.gcode_tools import converted, follow, strokes
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
    assert unaware.firmware.own(KlipperTable).shaper_freq_x == 0.0
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
    assert done["at"][:3] == pytest.approx(follow(files["part.gcode"]).points[-1], abs=1e-3), "mm"
    assert done["state"] == "complete"
    assert failed["state"] in ("error", "cancelled", "standby")
    if has_client:
        assert cancelled["heater"] == later["heater"] == 0.0
        assert like(failed, OWN)  # at once, by CANCEL_PRINT
        assert paused["noted"]["paused"] == 3000
    if CLIENTS[client][0] is CLIENT:
        assert cancelled["noted"]["cancelled"] == 3000


SQUARE = ["G1 X60 Y30 E{:.3f}", "G1 X60 Y60 E{:.3f}", "G1 X30 Y60 E{:.3f}", "G1 X30 Y30 E{:.3f}"]


def looped(mode: str) -> list[bytes]:
    """Return a print of five equal layers, written once."""
    walls = [row.format(1.0 if mode == "M83" else e) for e, row in enumerate(SQUARE, 1)]
    body = ["G92 E0", "G1 X30 Y30 F9000", "G91", "G1 Z.2", "G90", *walls]
    body += ["G1 E-1 F1800" if mode == "M83" else "G1 E3 F1800"]
    loop = ["SDCARD_LOOP_BEGIN COUNT=5", *body, "SDCARD_LOOP_END"]
    lines = ["G28", "G90", mode, "G1 X10 Y10 Z.2 F9000", *loop, "G1 X10 Y100"]
    return [f"{line}\n".encode() for line in lines]


def test_a_card_prints_loops_as_sliced_and_nothing_is_left_of_a_cancelled_print(
    machine: Printer, files: dict[str, bytes], tmp_path: Path
) -> None:
    """Not even for a file that does not say that its E is absolute, as after a restart."""
    lines = ["G28", "G90", "G92 E0", "G1 X30 Y30 Z.2 F9000", *SQUARE, ""]
    following = "\n".join(lines).format(*range(1, 5)).encode()
    card = {"part.gcode": files["part.gcode"], "next.gcode": following}
    for mode in ("M82", "M83"):
        card[f"{mode}.gcode"] = b"".join(looped(mode))
        card[f"ours{mode}.gcode"] = converted(looped(mode), machine)[0]
    names, script = [*card][1:], list[tuple[str, str]]()
    for name in ("next.gcode", *names):
        if script and name == "next.gcode":
            script += [PRINT, ("in mid-print", "CANCEL_PRINT")]
        script += [("at once", f"SDCARD_PRINT_FILE FILENAME={name}"), ("stopped", "")]
    host = sections("Klipper's own", machine, tmp_path) + "\n[sdcard_loop]\n"
    rows = [row["at"] for row in typed(script, card, host, tmp_path / "host")]
    first, _, cancelled, _, again, *looped_rows = rows[1:]
    assert again[:3] == first[:3] == [30.0, 30.0, 0.2]
    assert again[3] - cancelled[3] == pytest.approx(first[3]) == pytest.approx(4.0)
    before = again[3]
    for row in looped_rows[1::2]:
        assert row[:3] == pytest.approx([10.0, 100.0, 1.2], abs=1e-3)
        assert row[3] - before == pytest.approx(15.0, abs=1e-3), "mm of filament"
        before = row[3]
