"""``hframe-post measure``: every file that is printed so that something can be read from it.

SciPy takes a second to import, so commands import `identification` when they run: their help is
there at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hframe_post.arrays import X, Y
from hframe_post.cli.parameters import files_read, position, printer_option, quoted, say
from hframe_post.printer.profile import check_identified, load
from hframe_post.printer.settings import CHIP_NAME
from hframe_post.writers.outputs import Outputs
from hframe_post.writers.print_time import write_output

if TYPE_CHECKING:
    from hframe_post.identification.recordings.runs import PlannedRun
    from hframe_post.printer.settings import Printer

FILE = click.Path(path_type=Path, exists=True, dir_okay=False)  # that is read
HEIGHT = 10.0  # mm, at which a motion is played; the line G1 Z10 of the G-code
ONLY_FOR = {"places": "identify", "times": "identify"}


def _chip(text: str) -> str:
    if not CHIP_NAME.fullmatch(text):
        raise click.BadParameter(
            f"{text!r} is not a chip's name: for [adxl345 hotend] in printer.cfg type hotend"
        )
    return text


@click.command()
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
    metavar="OUT.GCODE", help="File to print.",
)  # fmt: skip
@printer_option
@click.option(
    "--for", "purpose", default="identify", show_default=True,
    type=click.Choice(["identify", "check"]), help="What to find out.",
)  # fmt: skip
@click.option(
    "--position", "places", type=position, multiple=True, metavar="X,Y",
    help="Where to measure, mm; may be repeated.",
)  # fmt: skip
@click.option(
    "--chip", "chips", type=_chip, multiple=True, metavar="NAME",
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
    given = {"places": places, "times": times > 1}
    for name, only in ONLY_FOR.items():
        if given[name] and purpose != only:
            option = {"places": "position"}.get(name, name)
            raise click.UsageError(f"--{option} is for --for {only}")
    profile = load(printer)
    if purpose == "identify" and not profile.firmware.kind.records:
        text = _sweep(output, printer, profile, places)
    else:
        text = _motion(output, printer, profile, purpose, places, chips, times)
    if not quiet:
        say(text)


def _motion(
    target: Path, printer: str, profile: Printer, purpose: str,
    places: tuple[tuple[float, float], ...], chips: tuple[str, ...], times: int,
) -> str:  # fmt: skip
    """Write runs that Klipper records, each with its command; return the summary."""
    from hframe_post.identification import check
    from hframe_post.identification.recordings import strokes
    from hframe_post.identification.recordings.folder import STROKES
    from hframe_post.identification.recordings.runs import moves_sensor

    if purpose != "identify":
        check_identified(profile)
    planned = strokes.runs(profile, places) if purpose == "identify" else check.runs(profile)
    jobs: dict[Path, list[PlannedRun]] = {}
    if moves_sensor(profile, planned, chips):
        for run in planned:
            jobs.setdefault(_of_axis(target, "xy"[run.axis]), []).append(run)
    repeated = {file: times * runs for file, runs in (jobs or {target: planned}).items()}
    _write_motion(target, printer, profile, planned, chips, repeated)
    if purpose != "identify":
        seconds = [f"{run.name}: {run.seconds:.1f} s" for run in planned]
        steps = _next_steps("check", target, printer, planned, list(jobs), purpose)
        return "\n".join([*seconds, steps])
    steps = _next_steps("identify", target, printer, planned, list(jobs), STROKES)
    return f"{strokes.summary(profile, times * planned)}\n{steps}"


def _of_axis(target: Path, axis: str) -> Path:
    """Return the file of one axis, where the sensor is moved between the axes."""
    return target.with_name(f"{target.stem}-{axis}.gcode")


def _write_motion(
    target: Path, printer: str, profile: Printer, planned: list[PlannedRun], chips: tuple[str, ...],
    jobs: Mapping[Path, list[PlannedRun]],
) -> None:  # fmt: skip
    from hframe_post.identification.recordings.formats import command_csv
    from hframe_post.identification.recordings.runs import gcode

    with Outputs(files_read(printer)) as outputs:
        motions = [(outputs.open(path), runs) for path, runs in jobs.items()]
        commands = [
            outputs.open(target.with_name(f"{target.stem}.{run.name}.csv")) for run in planned
        ]
        for motion, runs in motions:
            lines = gcode(profile, runs, chips, HEIGHT)
            write_output(motion, lines, lambda: (0.0, 0.0))
        for file, run in zip(commands, planned, strict=True):
            file.writelines(command_csv(run.command))


def _next_steps(
    command: str, target: Path, printer: str, planned: list[PlannedRun], jobs: Sequence[Path],
    recorded: str,
) -> str:  # fmt: skip
    """Return what to do with a file of runs: print it, fetch what was recorded, and read that.

    command: that reads. jobs: the two files of a printer whose sensor is moved to the bed between
    them. recorded: how the runs' names begin.
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
    # the commands and the recordings; what a folder of their own holds, identify sorts out
    both = [f"{inside}*{run.name}*.csv" for run in planned]
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


def _sweep(
    target: Path, printer: str, profile: Printer, places: tuple[tuple[float, float], ...]
) -> str:
    """Write a sweep for Marlin: a file for each run, TARGET.RUN.gcode, with its command."""
    from hframe_post.identification.recordings.formats import command_csv
    from hframe_post.identification.recordings.runs import positions
    from hframe_post.identification.recordings.written_sweep import runs, summary

    planned = [
        run
        for axis in (X, Y)
        for run in runs(profile, axis, list(places) or positions(profile, axis), HEIGHT)
    ]
    with Outputs(files_read(printer)) as outputs:
        for run, lines in planned:
            named = target.with_name(f"{target.stem}.{run.name}")
            outputs.open(Path(f"{named}.gcode")).write("\n".join([*lines, ""]).encode())
            outputs.open(Path(f"{named}.csv")).writelines(command_csv(run.command))
    done = [run for run, _ in planned]
    return summary(target.stem, done, profile.kinematics.type == "cartesian")
