"""A printer that measures itself and keeps its model right.

The real Moonraker, the real Klipper host, and an accelerometer that answers with a simulated
printer's response to what the host plans.
"""

import json
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hframe_post.printer.profile import load
from tests.hosts.klipper_server import machine_of
from tests.hosts.moonraker import Printer, until
from tests.quantities import below
from tests.random_printers import Errors, judged

PYTHON = os.environ.get("MOONRAKER_PYTHON", "")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.klipper,
    pytest.mark.skipif(not PYTHON, reason="MOONRAKER_PYTHON names no Python with Moonraker"),
]
MACHINE = {"kinematics": "corexy", "x": [43.0, 0.06], "y": [36.0, 0.08]}
DRIFTED = {**MACHINE, "x": [43.0 * 0.95, 0.06], "y": [36.0 * 0.95, 0.08]}
FOUND = "x rings at 43.0 Hz (damping 0.06), y rings at 36.0 Hz (damping 0.08)"


@pytest.fixture
def printer(tmp_path: Path) -> Iterator[Printer]:
    data = tmp_path / "printer_data"
    options = f"uploads: convert\nrecordings: {data}\n"
    sensor = f"[adxl345]\nmachine: {data}/machine.json"
    built = Printer(Path(PYTHON), tmp_path, options, sensor)
    try:
        built.start_klipper()
        built.start_moonraker()
        log = data / "logs/klippy.log"
        until(lambda: "registering remote method 'hframe_check'" in log.read_text())
        yield built
    finally:
        built.stop()


def machine_becomes(printer: Printer, machine: dict[str, Any]) -> None:
    (printer.data / "machine.json").write_text(json.dumps(machine))


def says(printer: Printer, command: str, text: str) -> list[str]:
    """Type a command; return what the console shows from then on, once a line has the text."""
    before = len(printer.console())
    printer.type(command)
    until(lambda: any(text in line for line in printer.console()[before:]))
    return printer.console()[before:]


def errors(printer: Printer, exact: bool = False) -> Errors:
    """Return the contour errors of two layers of the cube with the profile's or the exact model."""
    machine, profile = machine_of(printer.data / "machine.json"), load(str(printer.profile))
    profile = replace(profile, plant=machine.exact()) if exact else profile
    return judged(machine, profile, "cube")


def as_good_as_exact(printer: Printer) -> None:
    most = 1.2 * errors(printer, exact=True).compensated
    below(errors(printer).compensated, most, "contour error, µm RMS")


def test_one_macro_measures_the_printer_and_another_keeps_its_model_right(printer: Printer) -> None:
    (gone,) = [each for each in printer.get("/server/info")["warnings"] if "hframe_post" in each]
    assert "uploads can be deleted" in gone
    # without an answer of the sensor nothing changes
    unmeasured = printer.profile.read_bytes()
    says(printer, "HFRAME_CALIBRATE", "nothing is measured: No accelerometer measurements found")
    assert printer.profile.read_bytes() == unmeasured
    machine_becomes(printer, MACHINE)
    lines = says(printer, "HFRAME_CALIBRATE", "the model is written into")
    assert any(FOUND in line for line in lines)
    assert printer.profile.with_suffix(".html").exists()
    as_good_as_exact(printer)
    lines = says(printer, "HFRAME_CHECK", "the model is written into")
    assert any("x: the main resonance has not drifted" in line for line in lines)
    machine_becomes(printer, DRIFTED)
    assert errors(printer).compensated > 2.0 * errors(printer, exact=True).compensated
    lines = says(printer, "HFRAME_CHECK", "the model is written into")
    assert any("x: the main resonance moved from 42.9 to 40." in line for line in lines)
    as_good_as_exact(printer)
