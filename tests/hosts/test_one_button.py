"""A printer that measures itself, converts what is sent to it, and keeps its model right.

The real Moonraker, the real Klipper host, and an accelerometer that answers with a simulated
printer's response to what the host plans.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hframe_post.hosts.moonraker.originals import SETTINGS, settings_of
from hframe_post.printer.profile import load
from tests.command_line import RECTANGLE, run
from tests.hosts.accelerometer import machine_of
from tests.hosts.moonraker import Printer, until
from tests.quantities import below
from tests.random_printers import Errors, judged, with_plant

PYTHON = os.environ.get("MOONRAKER_PYTHON", "")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.klipper,
    pytest.mark.skipif(not PYTHON, reason="MOONRAKER_PYTHON names no Python with Moonraker"),
]
PART = RECTANGLE.read_bytes()
MACHINE = {"kinematics": "corexy", "x": [43.0, 0.06], "y": [36.0, 0.08]}
DRIFTED = {**MACHINE, "x": [43.0 * 0.95, 0.06], "y": [36.0 * 0.95, 0.08]}
FOUND = "x rings at 43.0 Hz (damping 0.06), y rings at 36.0 Hz (damping 0.08)"


@pytest.fixture
def printer(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Printer]:
    data = tmp_path / "printer_data"
    options = f"fresh: always\nrecordings: {data}\n"
    sensor = f"[adxl345]\nmachine: {data}/machine.json"
    built = Printer(Path(PYTHON), tmp_path, options, sensor, request.param)
    try:
        built.start_klipper()
        built.start_moonraker()
        until(lambda: built.get("/server/info")["klippy_state"] == "ready")
        yield built
    finally:
        built.stop()


def machine_becomes(printer: Printer, machine: dict[str, Any]) -> None:
    (printer.data / "machine.json").write_text(json.dumps(machine))


def said(printer: Printer, text: str) -> bool:
    return any(text in line for line in printer.console())


def present(printer: Printer) -> str:
    found = SETTINGS.match(run("-p", printer.profile, "--stamp").stdout)
    assert found
    return found["settings"].decode()


def errors(printer: Printer, exact: bool = False) -> Errors:
    """Return the contour errors of two layers of the cube with the profile's or the exact model."""
    machine, profile = machine_of(printer.data / "machine.json"), load(str(printer.profile))
    profile = with_plant(profile, machine.exact()) if exact else profile
    return judged(machine, profile, "cube")


def as_good_as_exact(printer: Printer) -> None:
    most = 1.2 * errors(printer, exact=True).compensated
    below(errors(printer).compensated, most, "contour error, µm RMS")


def printed(printer: Printer, name: str) -> None:
    printer.post(f"/printer/print/start?filename={name}")
    until(lambda: printer.print_stats()["state"] == "complete")
    assert printer.print_stats()["filename"] == name


@pytest.mark.parametrize("printer", ["corexy"], indirect=True)
def test_one_macro_and_one_upload(printer: Printer) -> None:
    path = printer.gcodes / "part.gcode"
    # before it is measured, a file prints as it was sliced
    printer.upload("part.gcode", PART)
    assert path.read_bytes() == PART
    machine_becomes(printer, MACHINE)
    printer.type("HFRAME_CALIBRATE")
    until(lambda: said(printer, "the model is written into"))
    assert said(printer, FOUND)
    assert printer.profile.with_suffix(".html").exists()
    # what is uploaded now is converted, and printed after a check that finds no drift
    printer.upload("part.gcode", PART, print="true")
    assert path.read_bytes() == printer.converted(PART)
    # the check before it completes, too
    ended = {"state": "complete", "filename": "part.gcode"}
    until(lambda: ended.items() <= printer.print_stats().items())
    assert said(printer, "x: the main resonance has not drifted")
    # after a drift, the next print is converted again first
    machine_becomes(printer, DRIFTED)
    assert errors(printer).compensated > 2.0 * errors(printer, exact=True).compensated
    printed(printer, "part.gcode")
    assert said(printer, "x: the main resonance moved from 42.9 to 40.")
    assert said(printer, "part.gcode: converted again")
    assert settings_of(path) == present(printer)
    assert path.read_bytes() == printer.converted(PART)
    as_good_as_exact(printer)
    # without an answer of the sensor the print goes on with the old model
    (printer.data / "machine.json").unlink()
    profile = printer.profile.read_bytes()
    printed(printer, "part.gcode")
    assert printer.console()[-1] == "Done printing file"
    assert said(printer, "nothing is measured: No accelerometer measurements found")
    assert printer.profile.read_bytes() == profile
