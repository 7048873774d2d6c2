"""``hframe-post sweep``: the motion by which a printer is identified."""

from __future__ import annotations

from pathlib import Path

import click

from hframe_post.cli.options import position, printer_option, say
from hframe_post.cli.sensing import chips_option, height_option, write_motion


@click.command()
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
    metavar="SWEEP.GCODE", help="G-code file; each run's command is written next to it, as CSV.",
)  # fmt: skip
@printer_option
@click.option(
    "--axis", type=click.Choice(["x", "y"]), default="x", show_default=True,
    help="The axis that moves.",
)  # fmt: skip
@click.option(
    "--position", "places", type=position, multiple=True, metavar="X,Y",
    help="Where to measure (mm); may be repeated. Default: at x_c and 30 and 60 mm to either side "
    "of it, as far as the travel allows, in the middle of y.",
)  # fmt: skip
@chips_option
@height_option
@click.option("-q", "--quiet", is_flag=True, help="No summary.")
def sweep(
    output: Path, printer: str, axis: str, places: tuple[tuple[float, float], ...],
    chips: tuple[str, ...], z: float | None, quiet: bool,
) -> None:  # fmt: skip
    """Write G-code that shakes the printer and records its accelerometers with Klipper.

    Each position is one run: a sine of rising frequency between two short equal marks. The exact
    command of a run is written next to the G-code, as SWEEP.RUN.csv; identify needs it. The
    profile's table [sweep] sets the frequencies and the acceleration. Home the printer first.

    \b
    Example:
      hframe-post sweep --axis x -p my.toml -o sweep.gcode
    """
    from hframe_post.identification.recordings.sweep import positions, runs, summary
    from hframe_post.printer.profile import load

    profile = load(printer)
    planned = runs(profile, "xy".index(axis), list(places) or positions(profile))
    write_motion(output, printer, profile, planned, chips, z)
    if not quiet:
        say("\n".join(summary(profile, run) for run in planned))
