"""``hframe-post calibrate-marlin``: which planner and timer a board has."""

from __future__ import annotations

from pathlib import Path

import click

from hframe_post.cli.options import files_read, printer_option


@click.command("calibrate-marlin")
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
    metavar="CALIBRATION.GCODE", help="G-code to print without filament.",
)  # fmt: skip
@printer_option
@click.option("-q", "--quiet", is_flag=True, help="No table.")
def calibrate_marlin(output: Path, printer: str, quiet: bool) -> None:
    """Write motions whose duration tells which planner and timer a Marlin board has.

    x moves along the middle of y, in two parts of about a minute and a half. Home first, then
    print the file from SD, and take the time of each part: with a stop-watch, from the host's
    log ("begins" and "ends" are echoed), or from the print time that M31 tells after each. The
    table says which keys of [firmware.marlin] each pair of durations means.

    \b
    Example:
      hframe-post calibrate-marlin -p my.toml -o calibrate.gcode
    """
    from hframe_post.firmware.marlin.calibration import calibration
    from hframe_post.printer.profile import load
    from hframe_post.writers.files.atomic_file import Outputs

    found = calibration(load(printer))
    with Outputs(files_read(printer)) as outputs:
        outputs.open(output).writelines(found.lines)
    if not quiet:
        head = "".join(f"{part:>10s}" for part in found.parts)
        rows = (
            f"{board:44s}" + "".join(f"{seconds:9.2f}s" for seconds in seconds_of)
            for board, seconds_of in found.durations.items()
        )
        click.echo("\n".join([f"{'':44s}{head}", *rows]), err=True)
        click.echo(
            "a steady part that is shorter than all of these: steps are smoothed, see "
            "adaptive_step_smoothing",
            err=True,
        )
