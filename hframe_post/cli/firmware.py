"""``hframe-post klipper-macros`` and ``calibrate-marlin``: what a firmware needs besides a file."""

from __future__ import annotations

from pathlib import Path

import click

from hframe_post.cli.options import files_read, old_option, printer_option, say
from hframe_post.firmware.klipper.macros import macros
from hframe_post.firmware.marlin.calibration import calibration
from hframe_post.printer.profile import load
from hframe_post.writers.files import Outputs


@click.command("klipper-macros")
@printer_option
def klipper_macros(printer: str) -> None:
    """Print macros for Klipper's printer.cfg, with this printer's limits.

    A converted file changes Klipper's limits while it prints. The macros restore the printer's
    limits when a print is paused or cancelled, and the file's when it is resumed. They replace
    PAUSE, RESUME and CANCEL_PRINT.

    \b
    Example:
      hframe-post klipper-macros -p my.toml >> printer.cfg
    """
    click.echo(macros(load(printer)), nl=False)


@click.command("calibrate-marlin")
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
    metavar="CALIBRATION.GCODE", help="G-code to print without filament.",
)  # fmt: skip
@printer_option
@old_option(
    "--quiet", "redirect standard error instead", "-q", is_flag=True
)  # fmt: skip
def calibrate_marlin(output: Path, printer: str, quiet: bool) -> None:
    """Write G-code whose duration shows which planner and timer a Marlin board has.

    x moves along the middle of y, in two parts of about a minute and a half each. Home the
    printer, print the file from SD, and note the duration of each part: from the print time that
    M31 reports after it, from "begins" and "ends" in the host's log, or with a stopwatch. Then look
    the pair up in the table that this command prints; it shows the keys for [firmware.marlin].

    \b
    Example:
      hframe-post calibrate-marlin -p my.toml -o calibrate.gcode
    """
    found = calibration(load(printer))
    with Outputs(files_read(printer)) as outputs:
        outputs.open(output).writelines(found.lines)
    if quiet:
        return
    say(" " * 44 + "".join(f"{part:>10s}" for part in found.parts))
    for board, durations in found.durations.items():
        say(f"{board:44s}" + "".join(f"{seconds:9.2f}s" for seconds in durations))
    say(
        "If the steady part is shorter than in every row, the board smooths steps: set "
        "firmware.marlin.adaptive_step_smoothing."
    )
