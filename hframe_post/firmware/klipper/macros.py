"""The text of hframe.cfg: macros that bring back Klipper's own limits and input shaping.

A print that stops inside the stream leaves Klipper with the stream's limits. The macros read the
printer's own from its configuration, which G-code cannot. A profile may name one as ``end_macro``.

Klipper merges two sections of one name, so a second ``[gcode_macro PAUSE]`` would replace an
owner's. But it compares names of sections by case and those of commands without it. So a section in
unusual spelling, with ``rename_existing``, is called first and passes the command on.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hframe_post.errors import PrinterError
from hframe_post.firmware.base import Finding
from hframe_post.firmware.klipper.klipper_code import SQUARE_CORNER_VELOCITY, KlipperCode
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.printer.firmware_tables import END_MACRO, MACROS, RECORDED, UNUSED, USUAL_CHIP
from hframe_post.printer.settings import Printer

FILE, BEGIN, END = MACROS, "_HFRAME_BEGIN", END_MACRO
WRAPPERS = {name: name[0].lower() + name[1:] for name in ("PAUSE", "RESUME", "CANCEL_PRINT")}
"""Klipper's command, and the spelling of the section that is called before it."""

_HEAD = f"""\
# {FILE}, written by hframe-post. Do not edit: 'hframe-post setup' overwrites it.
#
# A converted file raises Klipper's velocity limits and turns input shaping off while it prints.
# These macros restore your own settings when such a print is paused, cancelled or fails, and
# the file's when it is resumed. Your PAUSE, RESUME and CANCEL_PRINT run as before, whether they
# are Mainsail's, Fluidd's, yours or Klipper's. Let
#
#   [include {FILE}]
#
# be the last line of printer.cfg before the block that SAVE_CONFIG writes.
"""
_BUILTIN = "\n[pause_resume]\n"
_FORGET = "SET_GCODE_VARIABLE MACRO=_HFRAME_LEAVE VARIABLE=stream VALUE=None"
_ASKED = (
    "hframe-post writes the motion to record. If nothing follows, Moonraker has not started with "
    "it: run hframe-post connect moonraker on the printer's computer, then restart Moonraker"
)
_LIMITS = f"""
[gcode_macro {BEGIN}]
description: Set the limits of a converted file and turn input shaping off
gcode:
    {{% if "input_shaper" in printer.configfile.settings or "hframe_live" in printer %}}
    @shaper_off
    {{% endif %}}
    @limits
@averaging

[gcode_macro {END}]
description: Restore this printer's own limits and input shaping
gcode:
    {{% set own = printer.configfile.settings %}}
    SET_VELOCITY_LIMIT VELOCITY={{own.printer.max_velocity}} ACCEL={{own.printer.max_accel}} \
SQUARE_CORNER_VELOCITY={{own.printer.square_corner_velocity}} \
MINIMUM_CRUISE_RATIO={{own.printer.minimum_cruise_ratio|default(0.5)}}
    {{% if "input_shaper" in own %}}
    SET_INPUT_SHAPER SHAPER_FREQ_X={{own.input_shaper.shaper_freq_x}} \
SHAPER_FREQ_Y={{own.input_shaper.shaper_freq_y}} \
SHAPER_FREQ_Z={{own.input_shaper.shaper_freq_z|default(0)}}
    {{% endif %}}
    {{% if "hframe_live" in printer %}}
    SET_HFRAME_LIVE ENABLE={{printer.hframe_live.enabled|int}}
    {{% endif %}}
@own_averaging

# The next two ask hframe-post in Moonraker: 'hframe-post connect moonraker' connects it
[gcode_macro HFRAME_CALIBRATE]
description: Measure this printer; where the bed moves, AXIS=Y once the sensor is on the bed
gcode:
    {{% if "ACCELEROMETER_QUERY" not in printer.gcode.commands %}}
    {{action_raise_error("no accelerometer is configured in printer.cfg")}}
    {{% endif %}}
    {{action_respond_info("{_ASKED}")}}
    {{action_call_remote_method("hframe_calibrate", axis=params.AXIS|default("")|upper)}}

[gcode_macro HFRAME_CHECK]
description: Measure in 20 s what has drifted; FILENAME=check.gcode prints that file instead
gcode:
    {{% if "FILENAME" in params %}}
    _HFRAME_RECORD FILENAME="{{params.FILENAME}}"
    {{% else %}}
    {{action_respond_info("{_ASKED}")}}
    {{action_call_remote_method("hframe_check")}}
    {{% endif %}}

[gcode_macro HFRAME_TOWER]
description: Before a print: 5 mm compensated in Klipper, 5 mm bare, 5 mm with the input shaper
gcode:
    {{% set height = params.HEIGHT|default(5) %}}
    TUNING_TOWER COMMAND=SET_HFRAME_LIVE PARAMETER=TOWER STEP_DELTA=1 STEP_HEIGHT={{height}}

[gcode_macro _HFRAME_RECORD]
description: Home if needed, ask the accelerometers for a reading, and print FILENAME
gcode:
    {{% if printer.toolhead.homed_axes != "xyz" %}}
    G28
    {{% endif %}}
    @readings
    SDCARD_PRINT_FILE FILENAME="{{params.FILENAME}}"

# After M400 the print time is that at which the motion has ended, and it is read only once: the end
# of the first recording changes it. Without NAME the recordings are of no use
[gcode_macro {RECORDED}]
description: End the recordings of accelerometers; their names tell the print time in microseconds
gcode:
    {{% set name = params.NAME ~ "-t" ~ (printer.toolhead.print_time * 1000000)|round|int \
if "NAME" in params else "{UNUSED}" %}}
    {{% for chip in params.CHIPS.split(",") %}}
    ACCELEROMETER_MEASURE CHIP={{chip}} NAME={{name}}
    {{% endfor %}}

# stream: velocity and acceleration of the converted file that is paused
[gcode_macro _HFRAME_LEAVE]
description: If the limits of a converted file are in force, note them and restore the printer's
variable_stream: None
variable_ended: 0
gcode:
    {{% set now, own = printer.toolhead, printer.configfile.settings.printer %}}
    {{% set distinct = own.square_corner_velocity != @corner or own.minimum_cruise_ratio != 0 %}}
    {{% if now.square_corner_velocity == @corner and now.minimum_cruise_ratio|default(0) == 0 \
and (distinct or now.max_accel == @acceleration) %}}
    SET_GCODE_VARIABLE MACRO=_HFRAME_LEAVE VARIABLE=stream \
VALUE="{{(now.max_velocity, now.max_accel)}}"
    {END}
    {{% endif %}}

[gcode_macro _HFRAME_RETURN]
description: Set the limits that _HFRAME_LEAVE noted, if the print goes on
gcode:
    {{% set stream = printer["gcode_macro _HFRAME_LEAVE"].stream %}}
    {{% if stream and not ("pause_resume" in printer and printer.pause_resume.is_paused) %}}
    G4 P0
    {BEGIN}
    SET_VELOCITY_LIMIT VELOCITY={{stream[0]}} ACCEL={{stream[1]}}
    {_FORGET}
    {{% endif %}}

# A print that ends in an error may call no macro at all. ended: duration of the last one seen
[delayed_gcode _HFRAME_WATCH]
initial_duration: 2
gcode:
    UPDATE_DELAYED_GCODE ID=_HFRAME_WATCH DURATION=2
    {{% set seen = printer["gcode_macro _HFRAME_LEAVE"].ended %}}
    {{% set stats = printer.print_stats if "print_stats" in printer else {{"state": "none"}} %}}
    {{% set over = stats.state in ("complete", "cancelled", "error") %}}
    {{% set ended = stats.total_duration|round(6) if over else 0 %}}
    {{% set idle = printer.idle_timeout.state == "Idle" and stats.state != "paused" %}}
    {{% if idle or ended not in (0, seen) %}}
    _HFRAME_LEAVE
    {_FORGET}
    {{% endif %}}
    {{% if ended != seen %}}
    SET_GCODE_VARIABLE MACRO=_HFRAME_LEAVE VARIABLE=ended VALUE={{ended}}
    {{% endif %}}
"""
_OWN_AVERAGING = ["SET_PRESSURE_ADVANCE SMOOTH_TIME={own.extruder.pressure_advance_smooth_time}"]
# What precedes the wrappers: their odd capitals look like a mistake.
_WRAPPED = """
# Klipper would merge [gcode_macro PAUSE] with your own. It ignores capitals in a macro's name, but
# not in a section's, so these sections rename your macros and call them.
"""
_WRAPPER = """\
[gcode_macro @section]
description: Restore the printer's limits around a converted file, and call the former @name
rename_existing: _HFRAME_@name
gcode:
    @calls
"""
_CALLS = {
    "PAUSE": ("_HFRAME_LEAVE", "_HFRAME_PAUSE {rawparams}"),
    "RESUME": ("_HFRAME_RESUME {rawparams}", "_HFRAME_RETURN"),
    # the stream's E is relative: the next file may expect what holds after a restart
    "CANCEL_PRINT": ("_HFRAME_LEAVE", _FORGET, "M82", "_HFRAME_CANCEL_PRINT {rawparams}"),
}


def macros(printer: Printer, config: KlipperConfig | None = None) -> str:
    """Return the text of hframe.cfg for this printer.

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
    text = (
        _LIMITS.replace("@shaper_off", shaper_off)
        .replace("@limits", limits)
        .replace("@averaging\n", _averaging(code.averaging_of_stream))
        .replace("@own_averaging\n", _averaging(_OWN_AVERAGING if code.extruder else []))
        .replace("@corner", f"{SQUARE_CORNER_VELOCITY:g}")
        .replace("@acceleration", f"{code.stream.acceleration:g}")
        .replace("@readings", "\n    ".join(f"ACCELEROMETER_QUERY CHIP={chip}" for chip in chips))
    )
    # Klipper's own commands refuse a macro of their name that does not rename them
    own = _own_commands(config) if config is not None else []
    wrappers = "\n".join(map(_wrapper, own or WRAPPERS))
    return "".join([_HEAD, "" if own else _BUILTIN, text, _WRAPPED, wrappers])


def _averaging(lines: Sequence[str]) -> str:
    """Return lines of a macro that set over what time pressure advance is averaged."""
    if not lines:
        return ""
    guarded = ['{% if "extruder" in printer %}', *lines, "{% endif %}"]
    return "".join(f"    {line}\n" for line in guarded)


def _own_commands(config: KlipperConfig) -> list[str]:
    """Return the commands that macros define where Klipper's own are not configured."""
    if any(line.path.name != FILE for line in config.lines("pause_resume")):
        return []
    return [
        name
        for name in WRAPPERS
        if any(not config.text(section, "rename_existing") for section in config.macros(name))
    ]


def _wrapper(name: str) -> str:
    text = _WRAPPER.replace("@calls", "\n    ".join(_CALLS[name]))
    return text.replace("@section", WRAPPERS[name]).replace("@name", name)


# ----------------------------------------------------------------------
# Whether the macros of hframe.cfg are in force in a printer.cfg.

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
