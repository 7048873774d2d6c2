"""``hframe-post verify``: a test on the printer of whether its profile helps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from hframe_post.cli.json_summary import json_option, open_json
from hframe_post.cli.model_output import ModelOutput
from hframe_post.cli.options import files_read, old_option, page_option, printer_option, say
from hframe_post.cli.sweep import (
    FILE,
    chips_option,
    next_steps,
    recordings_argument,
    write_motion,
)
from hframe_post.errors import IdentificationError
from hframe_post.printer.profile import check_identified, load
from hframe_post.printer.settings import Verified
from hframe_post.writers.outputs import Outputs


@click.command()
@recordings_argument
@printer_option
@click.option(
    "--gcode", type=click.Path(path_type=Path, dir_okay=False), metavar="VERIFY.GCODE",
    help="Write the test motion, plain and compensated; both commands are written next to it.",
)  # fmt: skip
@click.option(
    "--motion", type=FILE, metavar="PART.GCODE",
    help="With --gcode: up to 40 s of this print's beginning as test motion, without filament and "
    "at one height. Default: a rectangle and a zigzag.",
)  # fmt: skip
@old_option("--plain", "give the folder with both recordings and their commands")
@old_option("--compensated", "give the folder with both recordings and their commands")
@old_option("--axes", "the recordings show how the sensor is mounted")
@chips_option
@page_option
@json_option
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="PROFILE.TOML",
    help="Write the profile, marked as verified, if the verdict is good.",
)  # fmt: skip
def verify(
    recordings: tuple[Path, ...], printer: str, gcode: Path | None, motion: Path | None,
    chips: tuple[str, ...], report_file: Path | None, json_file: Path | None, output: Path | None,
) -> None:  # fmt: skip
    """Check on the printer what a profile does: first --gcode, then both recordings.

    Put the recordings into one folder with the commands that --gcode wrote. Exits with status 1 if
    compensation does not help as the profile's model predicts.

    \b
    Example:
      hframe-post verify -p my.toml --gcode verify.gcode
      hframe-post verify -p my.toml recordings/ -o my.toml
    """
    if gcode is not None:
        _write(gcode, printer, motion, chips)
    elif recordings:
        _judge(printer, recordings, report_file, json_file, output)
    else:
        raise click.UsageError("give --gcode, or the folder with both recordings")


def _write(gcode: Path, printer: str, motion: Path | None, chips: tuple[str, ...]) -> None:
    from hframe_post.gcode.lines import lines_of
    from hframe_post.identification.verify import runs

    profile = load(printer)
    check_identified(profile)
    if motion is None:
        planned = runs(profile)
    else:
        with motion.open("rb") as file:
            planned = runs(profile, lines_of(file))
    write_motion(gcode, printer, profile, planned, chips)
    say(next_steps("verify", gcode, printer, planned))


def _judge(
    printer: str, recordings: tuple[Path, ...], report_file: Path | None, json_file: Path | None,
    output: Path | None,
) -> None:  # fmt: skip
    from hframe_post.identification.gather import from_folders
    from hframe_post.identification.pages import verification_page
    from hframe_post.identification.recordings.folder import VERIFY, files_in
    from hframe_post.identification.recordings.names import recorded_on
    from hframe_post.identification.verify import both, compare_runs

    profile, files = load(printer), files_in(recordings)
    sources = [*files_read(printer), *files]
    with Outputs(sources) as profiles:
        file = ModelOutput(profiles, output, printer) if output is not None else None
        with Outputs([*sources, *([output] if output else [])]) as reports:
            write_json = open_json(reports, json_file)
            html = reports.open(report_file) if report_file is not None else None
            gathered = from_folders(recordings, None, profile.travel, kinds=[VERIFY])
            runs = both(gathered.runs)
            verdict = compare_runs(profile, *runs)
            fault = None
            if verdict.fault is not None:
                fault = IdentificationError(f"the profile is not verified: {verdict.fault}")
            write_json(verdict.as_json(), error=fault)
            if html is not None:
                setup = [("recordings", ", ".join(run.name for run in runs))]
                name = profile.description or profile.name
                html.write(verification_page(verdict, name, setup))
        click.echo(verdict.as_text(), err=str(json_file) == "-")
        if fault is not None:
            raise fault
        if file is not None:
            labels = {label: path for path, label in files.items()}
            day = max(recorded_on(labels[run.name]) for run in runs).isoformat()
            mark = Verified(
                day, round(verdict.reduction, 4), profile.firmware.dialect, profile.model
            )
            file.write(replace(profile, verified=mark))
