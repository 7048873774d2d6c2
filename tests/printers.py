"""Configurations of printers, and profiles of them: new ones, and with a model as measured."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import tomlkit

from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.firmware.klipper.source import from_klipper, kinematics_in
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.printer import model_file
from hframe_post.printer.firmware_tables import MarlinTable
from hframe_post.printer.model_file import model_path, texts
from hframe_post.printer.new_profile import Known, profile_text
from hframe_post.printer.profile import load, parse
from hframe_post.printer.settings import Printer, Verified
from tests.conftest import ROOT

REAL = ROOT / "tests" / "klipper" / "printer.cfg"  # which Klipper itself runs with in other tests
M503 = ROOT / "tests" / "printer" / "m503.txt"  # with the answer to M115


def profile_of(config: KlipperConfig, kinematics: str = "") -> Printer:
    """Return the new profile of a printer.cfg; by default with the safest kinematics."""
    kind = kinematics or kinematics_in(config)[0]
    tables = {"kinematics": {"type": Known(kind, "test")}, **from_klipper(config)}
    return parse(profile_text(tables, "own"), "own")


def with_marlin(printer: Printer, **own: object) -> Printer:
    """Return the printer with other settings of its board."""
    table = replace(printer.firmware.own(MarlinTable), **own)  # type: ignore[arg-type]
    return replace(printer, firmware=replace(printer.firmware, tables=(table,)))


JERK: dict[str, object] = {"junction_deviation": 0.0, "jerk": (8.0, 8.0), "jerk_e": 5.0}
"""Settings of a board that is built with CLASSIC_JERK."""


def ender(acceleration: float = 1500.0, **own: object) -> Printer:
    """Return a bed-slinger of this acceleration, mm/s², and with other settings of its board."""
    printer = load("example-ender")
    limits = replace(printer.limits, acceleration=acceleration)
    return with_marlin(replace(printer, limits=limits), **own)


Windows = tuple[Window, Window]


def in_one(
    printer: Printer, source: str, notes: Sequence[str] | None = None, text: str | None = None
) -> str:
    """Return a profile that contains its model."""
    made = texts(printer, source, "mine.toml", notes, text)
    document: Any = tomlkit.parse(made.profile)
    del document["model"]
    for name, table in tomlkit.parse(made.model).items():
        if name in document:
            document[name].update(table)
        else:
            document.append(name, table)
    if printer.verified is not None:
        document["verified"]["model"] = parse(document.as_string(), "mine").model
    return str(document.as_string())


def in_two(path: Path, printer: Printer, source: str, notes: Sequence[str] | None = None) -> None:
    """Write a profile that names its model, and that model."""
    made = texts(printer, source, path, notes)
    path.write_text(made.profile)
    model_path(path).write_text(made.model)


def with_plant(
    source: str, plant: Plant, windows: Windows, notes: Sequence[str],
    uncertainty: float | None = None, text: str | None = None, measured: date | None = None,
) -> str:  # fmt: skip
    printer = load(source) if text is None else parse(text, "mine", source)
    found = model_file.measured(printer, plant, uncertainty, measured)
    return in_one(found.with_windows(windows), source, notes, text)


def with_verification(source: str, day: str, reduction: float) -> str:
    printer = load(source)
    mark = Verified(day, reduction, printer.firmware.dialect, printer.model)
    return in_one(replace(printer, verified=mark), source)
