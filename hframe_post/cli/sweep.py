"""``hframe-post sweep``: the motion by which a printer is identified."""

from __future__ import annotations

from pathlib import Path

import click

from hframe_post.cli.options import files_read, position, printer_option, say


def chip(text: str) -> str:
    """A name as Klipper takes it in CHIP=."""
    from hframe_post.identification.sweep import NAME

    if not NAME.fullmatch(text):
        raise click.BadParameter(
            f"{text!r} is no name: of [adxl345 hotend] in printer.cfg it is hotend"
        )
    return text


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
@click.option(
    "--chip", "chips", type=chip, multiple=True, default=("adxl345",), show_default=True,
    metavar="NAME", help="An accelerometer to record, as Klipper calls it; may be repeated.",
)  # fmt: skip
@click.option(
    "--z", type=click.FloatRange(0.0, 1e4), default=10.0, show_default=True, metavar="MM",
    help="Height at which to measure.",
)  # fmt: skip
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
    from hframe_post.identification import command_file
    from hframe_post.identification.sweep import gcode, positions, runs, told
    from hframe_post.printer.profile import load
    from hframe_post.writers.atomic_file import Outputs
    from hframe_post.writers.print_time import write_output

    profile = load(printer)
    planned = runs(profile, "xy".index(axis), list(places) or positions(profile))
    with Outputs(files_read(printer)) as outputs:
        motion = outputs.open(output)
        commands = [
            outputs.open(output.with_name(f"{output.stem}.{run.name}.csv")) for run in planned
        ]
        lines = gcode(profile, planned, tuple(dict.fromkeys(chips)), z)
        write_output(motion, lines, lambda: 0.0)
        for file, run in zip(commands, planned, strict=True):
            file.writelines(command_file.written(run.command))
    if not quiet:
        say("\n".join(told(profile, run) for run in planned))
