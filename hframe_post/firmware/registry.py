"""The firmwares that the output can be written for.

To add one: a table in ``printer.firmware_tables``, a ``Player`` in a module of this package, a row
here, and the meaning of its G-code for the reader in ``gcode.commands``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hframe_post.firmware.klipper.player import Klipper
from hframe_post.firmware.player import Player
from hframe_post.printer.firmware_tables import named
from hframe_post.printer.settings import Printer


@dataclass(frozen=True, slots=True)
class Firmware:
    """A firmware, by its name in profiles and on the command line.

    player: makes its ``Player`` from a printer, the tolerance of decimation (mm; None keeps every
    sample) and whether filament is retracted in motion. decimates: whether it uses the tolerance.
    """

    name: str
    label: str
    player: Callable[[Printer, float | None, bool], Player]
    decimates: bool


def _marlin(printer: Printer, tolerance: float | None, retract_moving: bool) -> Player:
    """Make Marlin's player. Its modules are imported here: most printers run Klipper."""
    from hframe_post.firmware.marlin.player import Marlin

    return Marlin.from_printer(printer, tolerance, retract_moving)


FIRMWARES = {
    each.name: each
    for each in (
        Firmware("klipper", "Klipper", Klipper.from_printer, decimates=True),
        Firmware("marlin", "Marlin", _marlin, decimates=False),
    )
}


def firmware(printer: Printer) -> Firmware:
    """Return the firmware that a printer's profile names. Raises PrinterError."""
    named(printer.firmware.dialect, "firmware.dialect", printer.name)
    return FIRMWARES[printer.firmware.dialect]


def player(printer: Printer, tolerance: float | None, retract_moving: bool = False) -> Player:
    """Return the player of a printer's firmware; see ``Firmware.player``.

    Raises PrinterError where the profile lacks the firmware's table, HframeError where it cannot
    retract in motion.
    """
    return firmware(printer).player(printer, tolerance, retract_moving)
