"""Macros for printer.cfg that end, pause and resume a print inside a stream.

A print that stops inside the stream leaves Klipper with the stream's limits. These macros read
the printer's own limits from its configuration, which G-code cannot. A profile may name them as
``begin_macro`` and ``end_macro``.
"""

from __future__ import annotations

from hframe_post.errors import PrinterError
from hframe_post.firmware.klipper.player import Klipper
from hframe_post.printer.settings import Printer

BEGIN, END = "HFRAME_BEGIN", "HFRAME_END"

_OWN = (
    "SET_VELOCITY_LIMIT VELOCITY={own.printer.max_velocity} ACCEL={own.printer.max_accel} "
    "SQUARE_CORNER_VELOCITY={own.printer.square_corner_velocity} "
    "MINIMUM_CRUISE_RATIO={own.printer.minimum_cruise_ratio}"
)
_MACROS = f"""\
[pause_resume]

[gcode_macro {BEGIN}]
gcode:
    {{% if "input_shaper" in printer.configfile.settings %}}
    @shaper_off
    {{% endif %}}
    @limits

[gcode_macro {END}]
gcode:
    {{% set own = printer.configfile.settings %}}
    {_OWN}
    {{% if "input_shaper" in own %}}
    SET_INPUT_SHAPER SHAPER_FREQ_X={{own.input_shaper.shaper_freq_x}} \
SHAPER_FREQ_Y={{own.input_shaper.shaper_freq_y}}
    {{% endif %}}

[gcode_macro CANCEL_PRINT]
rename_existing: CANCEL_PRINT_BASE
gcode:
    {END}
    G90
    M82
    # parking moves go here
    CANCEL_PRINT_BASE

[gcode_macro PAUSE]
rename_existing: PAUSE_BASE
variable_velocity: 0.0
variable_accel: 0.0
variable_corner: 0.0
variable_cruise: 0.0
gcode:
    {{% if not printer.pause_resume.is_paused %}}
    {{% set now = printer.toolhead %}}
    {{% set own = printer.configfile.settings %}}
    SET_GCODE_VARIABLE MACRO=PAUSE VARIABLE=velocity VALUE={{now.max_velocity}}
    SET_GCODE_VARIABLE MACRO=PAUSE VARIABLE=accel VALUE={{now.max_accel}}
    SET_GCODE_VARIABLE MACRO=PAUSE VARIABLE=corner VALUE={{now.square_corner_velocity}}
    SET_GCODE_VARIABLE MACRO=PAUSE VARIABLE=cruise VALUE={{now.minimum_cruise_ratio}}
    PAUSE_BASE
    {_OWN}
    # parking moves go here
    {{% endif %}}

[gcode_macro _HFRAME_RESUME]
gcode:
    {{% set then = printer["gcode_macro PAUSE"] %}}
    SET_VELOCITY_LIMIT VELOCITY={{then.velocity}} ACCEL={{then.accel}} \
SQUARE_CORNER_VELOCITY={{then.corner}} MINIMUM_CRUISE_RATIO={{then.cruise}}

[gcode_macro RESUME]
rename_existing: RESUME_BASE
gcode:
    {{% if printer.pause_resume.is_paused %}}
    RESTORE_GCODE_STATE NAME=PAUSE_STATE MOVE=1 MOVE_SPEED=50
    M400
    _HFRAME_RESUME
    RESUME_BASE
    {{% endif %}}
"""


def macros(printer: Printer) -> str:
    """Return sections for printer.cfg, with the limits of a stream for this printer.

    Raises PrinterError where the printer's firmware is not Klipper.
    """
    if printer.firmware.dialect != "klipper":
        cause = f"{printer.firmware.dialect} has no macros: they are for printer.cfg of Klipper"
        raise PrinterError(cause, "firmware.dialect", printer.name)
    shaper_off, limits = Klipper.from_printer(printer).limits_of_stream
    return _MACROS.replace("@shaper_off", shaper_off).replace("@limits", limits)
