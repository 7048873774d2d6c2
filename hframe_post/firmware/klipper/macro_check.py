"""Whether the macros of hframe.cfg are in force in a printer.cfg."""

from __future__ import annotations

from collections.abc import Iterator

from hframe_post.firmware.configuration import Finding
from hframe_post.firmware.klipper.macros import END, FILE, WRAPPERS, macros
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.printer.settings import Printer

LAST = f"make [include {FILE}] the last line before the block of SAVE_CONFIG"


def check_macros(config: KlipperConfig, printer: Printer, remedy: str) -> Iterator[Finding]:
    """Yield what keeps the printer's limits from coming back after a cancel, pause or error.

    remedy: how hframe.cfg is written for this profile.
    """
    for name, own in WRAPPERS.items():
        yield from _replaced(config, name, f"gcode_macro {own}")
    written = config.lines(f"gcode_macro {END}")
    if not any(config.has(f"gcode_macro {own}") for own in WRAPPERS.values()):
        yield Finding(
            True,
            f"{config.path}: {FILE} is not included, so a print that is cancelled, paused or fails "
            f"leaves the limits of the converted file in force: {remedy}, copy {FILE} next to "
            f"printer.cfg, and {LAST}",
        )
    elif not written or written[0].path.read_text("utf-8", "replace") != macros(printer, config):
        place = written[0].path if written else config.path
        yield Finding(
            True,
            f"{place}: {FILE} is not what this profile gives: {remedy}, and copy {FILE} next to "
            "printer.cfg again",
        )


def _replaced(config: KlipperConfig, name: str, own: str) -> Iterator[Finding]:
    """Yield what is wrong with the macros of a command. own: the section of hframe.cfg."""
    sections = config.macros(name)
    for section in sections:
        bodies = config.lines(section, "gcode")
        if section != own and END in config.text(section, "gcode"):
            yield Finding(
                True,
                f"{bodies[-1].place}: [{section}] is of an older hframe-post and replaces your "
                f"own {name}: delete it, and what hframe-post wrote next to it",
            )
        elif len(bodies) > 1:
            yield Finding(
                section == own,
                f"{bodies[-1].place}: replaces the [{section}] of {bodies[0].place}, because "
                "Klipper merges sections of one name: delete one of them if that is not intended",
            )
    if name == "CANCEL_PRINT" and own in sections and sections[-1] != own:
        later = config.place(sections[-1], "")
        included = f"include {FILE}"
        here = config.place(included if config.has(included) else own, "")
        yield Finding(
            True,
            f"{here}: [{sections[-1]}] at {later} comes later, so its moves run with the limits "
            f"of the converted file: {LAST}",
        )
