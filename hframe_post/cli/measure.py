"""``hframe-post measure``: the motion from which `identify` learns the printer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hframe_post.cli.options import position, printer_option, say
from hframe_post.cli.sweep import chips_option, next_steps, write_motion
from hframe_post.printer.profile import load

if TYPE_CHECKING:  # which imports SciPy: that takes a second
    from hframe_post.identification.recordings.sweep import SweepRun


@click.command()
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
    metavar="MEASURE.GCODE", help="G-code file; each run's command is written next to it, as CSV.",
)  # fmt: skip
@printer_option
@click.option(
    "--position", "places", type=position, multiple=True, metavar="X,Y",
    help="Where to measure (mm); may be repeated. Default: the middle of the travel and, for a "
    "printer that can rack, 60 mm to either side of it in x.",
)  # fmt: skip
@chips_option
@click.option("-q", "--quiet", is_flag=True, help="No summary.")
def measure(
    output: Path, printer: str, places: tuple[tuple[float, float], ...], chips: tuple[str, ...],
    quiet: bool,
) -> None:  # fmt: skip
    """Write G-code of strokes as in prints, which Klipper records with its accelerometers.

    Each position takes a minute: strokes, short infill and corners in random order, at the speeds
    and accelerations of the profile's [limits]. identify needs the exact command of a run, too,
    which is written next to the G-code as MEASURE.RUN.csv. Where the bed moves and one sensor
    records both axes, there are two files, and the sensor is moved in between. Home the printer
    first.

    \b
    Example:
      hframe-post measure -p my.toml -o measure.gcode
    """
    from hframe_post.identification.recordings.folder import STROKES
    from hframe_post.identification.recordings.strokes import runs, summary
    from hframe_post.identification.recordings.sweep import moves_sensor

    profile = load(printer)
    planned = runs(profile, places)
    jobs: dict[Path, list[SweepRun]] = {}
    if moves_sensor(profile, planned, chips):
        for run in planned:
            file = output.with_name(f"{output.stem}-{'xy'[run.axis]}.gcode")
            jobs.setdefault(file, []).append(run)
    write_motion(output, printer, profile, planned, chips, jobs)
    if not quiet:
        say(summary(profile, planned))
        say(next_steps("identify", output, printer, planned, list(jobs), recorded=STROKES))
