"""``hframe-post sweep``: the motion by which a printer is identified."""

from __future__ import annotations

from pathlib import Path

import click

from hframe_post.cli.options import position, printer_option, say
from hframe_post.cli.sensing import chips_option, height_option, write_motion


@click.command()
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
    metavar="SWEEP.GCODE", help="G-code; each run's command goes beside it, as CSV.",
)  # fmt: skip
@printer_option
@click.option(
    "--axis", type=click.Choice(["x", "y"]), default="x", show_default=True,
    help="The axis that moves.",
)  # fmt: skip
@click.option(
    "--position", "places", type=position, multiple=True, metavar="X,Y",
    help="Where to measure (mm); may be repeated. Default: 60 and 30 mm to either side of x_c "
    "and at x_c, as far as the travel goes, in the middle of y.",
)  # fmt: skip
@chips_option
@height_option
@click.option("-q", "--quiet", is_flag=True, help="No summary.")
def sweep(
    output: Path, printer: str, axis: str, places: tuple[tuple[float, float], ...],
    chips: tuple[str, ...], z: float, quiet: bool,
) -> None:  # fmt: skip
    """Write G-code that shakes the printer and records its accelerometers with Klipper.

    One run for each position: a sine whose frequency grows, between two short equal marks. The
    exact command of a run is written beside the G-code, as SWEEP.RUN.csv. The profile's table
    [sweep] says how fast and how hard. Home the printer first.

    \b
    Example:
      hframe-post sweep --axis x -p my.toml -o sweep.gcode
    """
    from hframe_post.identification.recordings.sweep import positions, runs, told
    from hframe_post.printer.profile import load

    profile = load(printer)
    planned = runs(profile, "xy".index(axis), list(places) or positions(profile))
    write_motion(output, printer, profile, planned, chips, z)
    if not quiet:
        say("\n".join(told(profile, run) for run in planned))
