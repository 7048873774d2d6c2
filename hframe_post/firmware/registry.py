"""The firmwares that the output can be written for.

Adding one takes a table in ``printer.firmware_tables``, a ``Player`` in a module beside this, a
row here, and what its G-code means to the reader, in ``gcode.commands``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from hframe_post.errors import HframeError
from hframe_post.firmware.klipper.player import Klipper, retracts_moving
from hframe_post.firmware.klipper.player import passing as klippers_passing
from hframe_post.firmware.marlin.player import Marlin
from hframe_post.firmware.player import Player
from hframe_post.printer.firmware_tables import named
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Rests


def _comes_to_rest(_: Printer) -> Rests:
    return Rests()


@dataclass(frozen=True, slots=True)
class Firmware:
    """A firmware, by the name that it has in profiles and on the command line.

    player: builds what the writer asks, from a printer and the mm that decimation may miss a
    sample by (None keeps them all); decimates: whether that tolerance means anything to it.
    passing: how lifts pass into motion on that printer; retracts_moving: mm/s² of filament that is
    retracted in motion; None: it cannot be.
    """

    name: str
    label: str
    player: Callable[[Printer, float | None], Player]
    decimates: bool = False
    passing: Callable[[Printer], Rests] = _comes_to_rest
    retracts_moving: Callable[[Printer], float] | None = None


FIRMWARES = {
    each.name: each
    for each in (
        Firmware("klipper", "Klipper", Klipper.of, True, klippers_passing, retracts_moving),
        Firmware("marlin", "Marlin", Marlin.of),
    )
}


def firmware(printer: Printer) -> Firmware:
    """The firmware that a printer's profile has chosen. Raises PrinterError."""
    named(printer.firmware.dialect, "firmware.dialect", printer.name)
    return FIRMWARES[printer.firmware.dialect]


def player(printer: Printer, tolerance: float | None, moving: bool = False) -> Player:
    """That firmware, as it plays this printer's stream. Raises PrinterError.

    moving: filament is retracted in motion.
    """
    made = firmware(printer).player(printer, tolerance)
    return replace(made, retracts_moving=moving) if isinstance(made, Klipper) else made


def passing(printer: Printer, tolerance: float | None, moving: bool = False) -> Rests:
    """How lifts and, if asked, retractions pass into motion. Raises HframeError.

    Lifts come to rest where every sample is written, however short its way.
    """
    chosen = firmware(printer)
    if moving and chosen.retracts_moving is None:
        raise HframeError(f"{chosen.label} does not retract in motion: that is for Klipper")
    lifts = chosen.passing(printer) if tolerance is not None else Rests()
    of_filament = chosen.retracts_moving(printer) if moving and chosen.retracts_moving else 0.0
    return replace(lifts, moving=of_filament)
