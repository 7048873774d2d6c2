"""``hframe-post measure``: every file that is printed so that something can be read from it.

SciPy takes a second to import, so commands import `identification` when they run: their help is
there at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hframe_post.arrays import X, Y
from hframe_post.cli.parameters import WRITTEN, files_read, position, quoted, say, shared, typed
from hframe_post.printer.profile import check_identified, load
from hframe_post.printer.settings import chip_name
from hframe_post.writers.outputs import Outputs
from hframe_post.writers.print_time import Output, write_output

if TYPE_CHECKING:
    from hframe_post.identification.recordings.runs import PlannedRun
    from hframe_post.printer.settings import Printer

HEIGHT = 10.0  # mm, at which a motion is played; the line G1 Z10 of the G-code


@click.command()
@click.option(
    "-o", "--output", required=True, type=WRITTEN, metavar="OUT.GCODE", help="File to print."
)
@shared("printer")
@click.option(
    "--for", "purpose", default="identify", show_default=True,
    type=click.Choice(["identify", "check"]), help="What to find out.",
)  # fmt: skip
@click.option(
    "--position", "places", type=position, multiple=True, metavar="X,Y",
    help="Where to measure, mm; may be repeated.",
)  # fmt: skip
@click.option(
    "--chip", "chips", type=typed(chip_name), multiple=True, metavar="NAME",
    help="Klipper's name of the accelerometer; may be repeated.",
)  # fmt: skip
@click.option(
    "--times", type=click.IntRange(1, 10), default=1, show_default=True, metavar="N",
    help="How often to play each run.",
)  # fmt: skip
@click.option("-q", "--quiet", is_flag=True, help="Print no summary.")
def measure(
    output: Path, printer: str, purpose: str, places: tuple[tuple[float, float], ...],
    chips: tuple[str, ...], times: int, quiet: bool,
) -> None:  # fmt: skip
    """Write the G-code that measures a printer. Home the printer, then print it.

    \b
    identify  strokes as in prints, a minute at each position; with Marlin, sweeps
    check     20 s: what has drifted since identify, and what compensation brings

    The command of each run is written next to the file. The summary says what to do next.

    \b
    Example:
      hframe-post measure -p my.toml -o measure.gcode
    """
    for option, given in (("--position", bool(places)), ("--times", times > 1)):
        if given and purpose != "identify":
            raise click.UsageError(f"{option} is for --for identify")
    profile = load(printer)
    if purpose == "identify" and not profile.firmware.kind.records:
        files, summary = _sweeps(output, profile, places)
    else:
        files, summary = _recorded(output, printer, profile, purpose, places, chips, times)
    _write(output, printer, files)
    if not quiet:
        say(summary)


def _sweeps(
    target: Path, profile: Printer, places: tuple[tuple[float, float], ...]
) -> tuple[list[_File], str]:
    """Return sweeps that another program records, a file for each, and what to do with them."""
    from hframe_post.identification.recordings.written_sweep import runs, summary

    files = [
        _File(target.with_name(f"{target.stem}.{run.name}.gcode"), [run],
              (f"{line}\n".encode() for line in lines))
        for run, lines in runs(profile, places, HEIGHT)
    ]  # fmt: skip
    done = [run for file in files for run in file.runs]
    return files, summary(target.stem, done, profile.kinematics.type == "cartesian")


def _recorded(
    target: Path, printer: str, profile: Printer, purpose: str,
    places: tuple[tuple[float, float], ...], chips: tuple[str, ...], times: int,
) -> tuple[list[_File], str]:  # fmt: skip
    """Return the file of the runs that Klipper records, two where its sensor must be moved between
    the axes, and what to do with it."""
    from hframe_post.identification import check
    from hframe_post.identification.recordings import strokes
    from hframe_post.identification.recordings.folder import STROKES
    from hframe_post.identification.recordings.runs import gcode, moves_sensor

    if purpose == "identify":
        planned, recorded = strokes.runs(profile, places), STROKES
        summary = strokes.summary(profile, times * planned)
    else:
        check_identified(profile)
        planned, recorded = check.runs(profile), purpose
        summary = "\n".join(f"{run.name}: {run.seconds:.1f} s" for run in planned)
    jobs = {target: planned}
    if moves_sensor(profile, planned, chips):
        of_axis = {axis: [run for run in planned if run.axis == axis] for axis in (X, Y)}
        jobs = {
            target.with_name(f"{target.stem}-{'xy'[axis]}.gcode"): runs
            for axis, runs in of_axis.items()
        }
    files = [
        _File(path, runs, gcode(profile, times * runs, chips, HEIGHT))
        for path, runs in jobs.items()
    ]
    return files, f"{summary}\n{_next_steps(purpose, target, printer, files, recorded)}"


@dataclass(frozen=True, slots=True)
class _File:
    """A file of G-code to print, and the runs in it, each of which has a file of its command."""

    path: Path
    runs: list[PlannedRun]
    lines: Iterable[Output]


def _write(target: Path, printer: str, files: Sequence[_File]) -> None:
    from hframe_post.identification.recordings.formats import command_csv

    target.parent.mkdir(parents=True, exist_ok=True)  # the recordings are to be put there, too
    with Outputs(files_read(printer)) as outputs:
        motions = [(outputs.open(file.path), file) for file in files]
        commands = [
            (outputs.open(target.with_name(f"{target.stem}.{run.name}.csv")), run)
            for file in files
            for run in file.runs
        ]
        for motion, file in motions:
            write_output(motion, file.lines, lambda: (0.0, 0.0))
        for command, run in commands:
            command.writelines(command_csv(run.command))


def _next_steps(
    command: str, target: Path, printer: str, files: Sequence[_File], recorded: str
) -> str:
    """Return what to do with files of runs: print them, fetch what was recorded, and read that.

    command: that reads. recorded: how the runs' names begin.
    """
    print_it = f"print {target.name}, and"
    if len(files) > 1:
        on_head, on_bed = (file.path.name for file in files)
        print_it = (
            f"print {on_head} with the sensor on the head,\n"
            f"move the sensor to the bed, print {on_bed}, and"
        )
    folder = target.parent
    inside = "" if folder == Path() else quoted(f"{folder}/")  # quotes stop a shell from matching *
    # the commands and the recordings; what a folder of their own holds, identify sorts out
    both = [f"{inside}*{run.name}*.csv" for file in files for run in file.runs]
    if command == "identify" and inside:
        both = [quoted(folder)]
    profile = Path(printer if Path(printer).is_file() else "printer.toml")
    same = command == "identify" and profile == Path(printer)  # it completes that of -o
    chosen = "" if same else f" -p {quoted(printer)}"
    return "\n".join(
        [
            f"Next, home the printer, {print_it} fetch what Klipper recorded:",
            f'  scp "pi@printer.local:/tmp/*-{recorded}-*.csv" {quoted(folder)}',
            "Then type",
            f"  hframe-post {command}{chosen} {' '.join(both)} -o {quoted(profile)}",
        ]
    )
