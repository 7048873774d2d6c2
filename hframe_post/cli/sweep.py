"""``hframe-post sweep`` and ``measure``, and what identify, check and verify share with them.

SciPy takes a second to import, so these commands import `identification` when they run: their
help is there at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hframe_post.arrays import X, Y
from hframe_post.cli.options import (
    files_read,
    old_option,
    position,
    printer_option,
    quoted,
    say,
)
from hframe_post.errors import PrinterError
from hframe_post.printer.profile import load
from hframe_post.printer.settings import CHIP_NAME
from hframe_post.writers.outputs import Outputs
from hframe_post.writers.print_time import write_output

if TYPE_CHECKING:
    from hframe_post.identification.recordings.runs import PlannedRun
    from hframe_post.printer.settings import Printer

FILE = click.Path(path_type=Path, exists=True, dir_okay=False)  # that is read
HEIGHT = 10.0  # mm, at which a motion is played; the line G1 Z10 of the G-code


def _chip(text: str) -> str:
    if not CHIP_NAME.fullmatch(text):
        raise click.BadParameter(
            f"{text!r} is not a chip's name: for [adxl345 hotend] in printer.cfg type hotend"
        )
    return text


recordings_argument = click.argument(
    "recordings", nargs=-1, metavar="[FOLDER|FILES]...",
    type=click.Path(path_type=Path, exists=True),
)  # fmt: skip
chips_option = click.option(
    "--chip", "chips", type=_chip, multiple=True, metavar="NAME",
    help="Accelerometer to record, by its name in Klipper; may be repeated. Default: sweep.chip_x "
    "and chip_y of the profile, which setup finds in printer.cfg, or else adxl345.",
)  # fmt: skip
places_option = click.option(
    "--position", "places", type=position, multiple=True, metavar="X,Y",
    help="Where to measure (mm); may be repeated. Default: the middle of the travel and, for a "
    "printer that can rack, 60 mm to either side of it in x.",
)  # fmt: skip


def write_motion(
    target: Path, printer: str, profile: Printer, planned: list[PlannedRun], chips: tuple[str, ...],
    jobs: Mapping[Path, list[PlannedRun]] | None = None,
) -> None:  # fmt: skip
    """Write the runs as G-code, and next to it each command as TARGET.RUN.csv.

    jobs: the runs of each file of G-code, if they are not all in ``target``.
    """
    from hframe_post.identification.recordings.formats import command_csv
    from hframe_post.identification.recordings.runs import gcode

    with Outputs(files_read(printer)) as outputs:
        motions = [(outputs.open(path), runs) for path, runs in (jobs or {target: planned}).items()]
        commands = [
            outputs.open(target.with_name(f"{target.stem}.{run.name}.csv")) for run in planned
        ]
        for motion, runs in motions:
            lines = gcode(profile, runs, chips, HEIGHT)
            write_output(motion, lines, lambda: (0.0, 0.0))
        for file, run in zip(commands, planned, strict=True):
            file.writelines(command_csv(run.command))


def write_moves(
    target: Path, printer: str, done: Sequence[tuple[PlannedRun, list[str]]]
) -> list[PlannedRun]:
    """Write a file of moves for each run, TARGET.RUN.gcode, with its command; return the runs."""
    from hframe_post.identification.recordings.formats import command_csv

    with Outputs(files_read(printer)) as outputs:
        for run, lines in done:
            named = target.with_name(f"{target.stem}.{run.name}")
            outputs.open(Path(f"{named}.gcode")).write("\n".join([*lines, ""]).encode())
            outputs.open(Path(f"{named}.csv")).writelines(command_csv(run.command))
    return [run for run, _ in done]


def next_steps(
    command: str, target: Path, printer: str, planned: list[PlannedRun], jobs: Sequence[Path] = (),
    recorded: str = "",
) -> str:  # fmt: skip
    """Return what to do with a file of runs: print it, fetch what was recorded, and judge that.

    command: that judges. jobs: the two files of a printer whose sensor is moved to the bed between
    them. recorded: how the runs' names begin, if not with the command.
    """
    print_it = f"print {target.name}, and"
    if jobs:
        on_head, on_bed = (path.name for path in jobs)
        print_it = (
            f"print {on_head} with the sensor on the head,\n"
            f"move the sensor to the bed, print {on_bed}, and"
        )
    folder = target.parent
    inside = "" if folder == Path() else quoted(f"{folder}/")  # quotes stop a shell from matching *
    both = (f"{inside}*{run.name}*.csv" for run in planned)  # the command and the recording
    profile = Path(printer if Path(printer).is_file() else "printer.toml")
    return "\n".join(
        [
            *(f"{run.name}: {run.seconds:.1f} s" for run in planned),
            f"Next, home the printer, {print_it} fetch what Klipper recorded:",
            f'  scp "pi@printer.local:/tmp/*-{recorded or command}-*.csv" {quoted(folder)}',
            "Then type",
            f"  hframe-post {command} -p {quoted(printer)} {' '.join(both)} -o {quoted(profile)}",
        ]
    )


@click.command()
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
    metavar="SWEEP.GCODE", help="Each run has a file, SWEEP.RUN.gcode, and a command, a CSV.",
)  # fmt: skip
@printer_option
@click.option(
    "--axis", type=click.Choice(["x", "y"]),
    help="Sweep this axis only. Default: both, one after the other.",
)  # fmt: skip
@places_option
@old_option("--chip", "Klipper records its accelerometers with the file of 'hframe-post measure'")
@click.option("-q", "--quiet", is_flag=True, help="No summary.")
def sweep(
    output: Path, printer: str, axis: str | None, places: tuple[tuple[float, float], ...],
    quiet: bool,
) -> None:  # fmt: skip
    """Write G-code that shakes a printer with Marlin, to be recorded by any program.

    Each position is one run of half a minute: moves whose speed pulses ever faster. The exact
    command of a run is written next to the G-code, as SWEEP.RUN.csv; identify needs it. The
    profile's table [sweep] sets the frequencies and the acceleration, [limits] the most that they
    may be. Home the printer first.

    \b
    Example:
      hframe-post sweep -p my.toml -o sweep.gcode
    """
    from hframe_post.identification.recordings.runs import positions
    from hframe_post.identification.recordings.written_sweep import runs, summary

    profile = load(printer)
    if profile.firmware.kind.records:
        raise PrinterError(
            "Klipper records by itself what 'hframe-post measure' writes, which tells more than a "
            "sweep", "firmware.dialect", profile.name,
        )  # fmt: skip
    planned = [
        run
        for each in ((X, Y) if axis is None else ("xy".index(axis),))
        for run in runs(profile, each, list(places) or positions(profile, each), HEIGHT)
    ]
    done = write_moves(output, printer, planned)
    if not quiet:
        say(summary(output.stem, done, profile.kinematics.type == "cartesian"))


@click.command()
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
    metavar="MEASURE.GCODE", help="G-code file; each run's command is written next to it, as CSV.",
)  # fmt: skip
@printer_option
@places_option
@chips_option
@click.option(
    "--times", type=click.IntRange(1, 10), default=1, show_default=True, metavar="N",
    help="How often to play each run: what does not repeat is then known, and not compensated.",
)  # fmt: skip
@click.option("-q", "--quiet", is_flag=True, help="No summary.")
def measure(
    output: Path, printer: str, places: tuple[tuple[float, float], ...], chips: tuple[str, ...],
    times: int, quiet: bool,
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
    from hframe_post.identification.recordings.runs import moves_sensor
    from hframe_post.identification.recordings.strokes import runs, summary

    profile = load(printer)
    planned = runs(profile, places)
    jobs: dict[Path, list[PlannedRun]] = {}
    if moves_sensor(profile, planned, chips):
        for run in planned:
            file = output.with_name(f"{output.stem}-{'xy'[run.axis]}.gcode")
            jobs.setdefault(file, []).append(run)
    repeated = {file: times * runs for file, runs in (jobs or {output: planned}).items()}
    write_motion(output, printer, profile, planned, chips, repeated)
    if not quiet:
        say(summary(profile, times * planned))
        say(next_steps("identify", output, printer, planned, list(jobs), recorded=STROKES))
