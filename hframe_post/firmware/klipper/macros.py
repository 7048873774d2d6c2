"""hframe.cfg, from its template: macros that bring back Klipper's own limits and input shaping.

A print that stops inside the stream leaves Klipper with the stream's limits. The macros read the
printer's own from its configuration, which G-code cannot. A profile may name one as ``end_macro``.

Klipper merges two sections of one name, so a second ``[gcode_macro PAUSE]`` would replace an
owner's. But it compares names of sections by case and those of commands without it. So a section in
unusual spelling, with ``rename_existing``, is called first and passes the command on.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import resources

from hframe_post.errors import PrinterError
from hframe_post.firmware.klipper.klipper_stream import KlipperCode
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.printer.firmware_tables import END_MACRO, MACROS, RECORDED, UNUSED, USUAL_CHIP
from hframe_post.printer.new_profile import Finding
from hframe_post.printer.settings import Printer

FILE, END = MACROS, END_MACRO
WRAPPERS = {name: name[0].lower() + name[1:] for name in ("PAUSE", "RESUME", "CANCEL_PRINT")}
"""Klipper's command, and the spelling of the section that is called before it."""

TEMPLATE = f"{FILE}.in"  # of this file; see `macros`


def macros(printer: Printer, config: KlipperConfig | None = None) -> str:
    """Return the text of hframe.cfg for this printer.

    In its template @name stands for what depends on the printer, and a line that begins with @part:
    is only in the file if the printer needs that part. CANCEL_PRINT sends M82, since the stream's E
    is relative: the next file may expect what holds after a restart.

    config: its printer.cfg; without it nothing but Klipper's own commands is assumed. Raises
    PrinterError where the printer's firmware is not Klipper.
    """
    if printer.firmware.dialect != "klipper":
        cause = f"{printer.firmware.dialect} has no macros: they are for printer.cfg of Klipper"
        raise PrinterError(cause, "firmware.dialect", printer.name)
    code = KlipperCode.from_printer(printer)
    shaper_off, limits = code.limits_of_stream
    known = dict.fromkeys((printer.sweep.chip_x, printer.sweep.chip_y))
    chips = [chip for chip in known if chip] or [USUAL_CHIP]
    # Klipper's own commands refuse a macro of their name that does not rename them
    own = _own_commands(config) if config is not None else []
    text = (resources.files(__package__) / TEMPLATE).read_text("utf-8")
    for part, needed in {
        "builtin": not own,
        "averaging": code.extruder is not None,
        **{name: name in (own or WRAPPERS) for name in WRAPPERS},
    }.items():
        text = re.sub(rf"(?m)^@{part}:(.*\n)", r"\1" if needed else "", text)
    for name, value in {
        "@shaper_off": shaper_off,
        "@limits": limits,
        "@averaging": "".join(code.averaging_of_stream),
        "@corner": f"{code.stream.square_corner_velocity:g}",
        "@acceleration": f"{code.stream.acceleration:g}",
        "@readings": "\n    ".join(f"ACCELEROMETER_QUERY CHIP={chip}" for chip in chips),
        "@recorded": RECORDED,
        "@unused": UNUSED,
    }.items():
        text = text.replace(name, value)
    return text.rstrip() + "\n"


def _own_commands(config: KlipperConfig) -> list[str]:
    """Return the commands that macros define where Klipper's own are not configured."""
    if any(line.path.name != FILE for line in config.lines("pause_resume")):
        return []
    return [
        name
        for name in WRAPPERS
        if any(not config.text(section, "rename_existing") for section in config.macros(name))
    ]


# ----------------------------------------------------------------------
# Whether the macros of hframe.cfg are in force in a printer.cfg.

LAST = f"make [include {FILE}] the last line before the block of SAVE_CONFIG"


def check_macros(config: KlipperConfig, printer: Printer, remedy: str) -> Iterator[Finding]:
    """Yield what keeps the printer's limits from coming back after a cancel, pause or error.

    remedy: how hframe.cfg is written for this profile.
    """
    own, cancels = f"gcode_macro {WRAPPERS['CANCEL_PRINT']}", config.macros("CANCEL_PRINT")
    if own in cancels and cancels[-1] != own:
        included = f"include {FILE}"
        here = config.place(included if config.has(included) else own, "")
        yield Finding(
            True,
            f"{here}: [{cancels[-1]}] at {config.place(cancels[-1], '')} comes later, so its moves "
            f"run with the limits of the converted file: {LAST}",
        )
    written = config.lines(f"gcode_macro {END}")
    if not any(config.has(f"gcode_macro {each}") for each in WRAPPERS.values()):
        yield Finding(
            True,
            f"{config.path}: {FILE} is not included, so a print that is cancelled, paused or fails "
            f"leaves the limits of the converted file in force: {remedy}, copy {FILE} next to "
            f"printer.cfg, and {LAST}",
        )
    elif not written or written[-1].path.read_text("utf-8", "replace") != macros(printer, config):
        place = written[-1].path if written else config.path
        yield Finding(
            True,
            f"{place}: {FILE} is not what this profile gives: {remedy}, and copy {FILE} next to "
            "printer.cfg again",
        )
