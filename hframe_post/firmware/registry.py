"""The firmwares that the output can be written for. architecture.md says how to add one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hframe_post.firmware.base import Firmware, Source
from hframe_post.firmware.klipper.klipper_firmware import Klipper
from hframe_post.firmware.marlin.marlin_firmware import Marlin
from hframe_post.printer.firmware_tables import check_needs
from hframe_post.printer.settings import Printer

FIRMWARES: dict[str, type[Firmware]] = {each.name: each for each in (Klipper, Marlin)}


def firmware(printer: Printer) -> Firmware:
    """Return the firmware that a printer names. Raises PrinterError: a library's may lack it."""
    check_needs(printer.firmware, printer.steps is not None, printer.name)
    return FIRMWARES[printer.firmware.dialect](printer)


def source_of(files: Sequence[Path]) -> Source:
    """Return what the files of a firmware say of a printer. Raises HframeError.

    Klipper is asked last: it takes all files, and says what is wrong with those of no firmware.
    """
    sources = (FIRMWARES[name].source(files) for name in reversed([*FIRMWARES]))
    return next(source for source in sources if source is not None)
