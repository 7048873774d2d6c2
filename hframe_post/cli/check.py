"""``hframe-post check``: what has drifted since the profile was identified."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hframe_post.cli.json_summary import json_option, open_json
from hframe_post.cli.model_output import ModelOutput
from hframe_post.cli.options import (
    files_read,
    old_option,
    printer_option,
    say,
)
from hframe_post.cli.sweep import (
    chips_option,
    next_steps,
    recordings_argument,
    write_motion,
)
from hframe_post.errors import IdentificationError, PrinterError
from hframe_post.printer.profile import check_identified, load
from hframe_post.writers.outputs import Outputs

if TYPE_CHECKING:  # which imports SciPy, as do the imports in functions: that takes a second
    from hframe_post.identification.gather import Gathered
    from hframe_post.printer.settings import Printer


@click.command()
@recordings_argument
@printer_option
@click.option(
    "--gcode", type=click.Path(path_type=Path, dir_okay=False), metavar="CHECK.GCODE",
    help="Write the run; the command of each axis is written next to it.",
)  # fmt: skip
@old_option("--axis", "the run moves both axes; where the bed moves, there is a file for each")
@old_option("--axes", "the recordings show how the sensor is mounted")
@chips_option
@json_option
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="PROFILE.TOML",
    help="Write the profile with the model and the uncertainty of today.",
)  # fmt: skip
def check(
    recordings: tuple[Path, ...], printer: str, gcode: Path | None, chips: tuple[str, ...],
    json_file: Path | None, output: Path | None,
) -> None:  # fmt: skip
    """Measure in 20 s what drifted, before a print or once a week: first --gcode, then the files.

    The run is that of `measure` for 20 s, in the middle of the bed. Its file is written once; where
    the bed moves and one sensor records both axes, there are two, and the sensor is moved in
    between.
    The recordings then update the profile's response; one of poles and zeros becomes a measured
    one. A recording of another printer is refused with status 1. Without
    recordings, the age of the model raises its uncertainty.

    \b
    Example:
      hframe-post check -p my.toml --gcode check.gcode
      hframe-post check -p my.toml check.check-*.csv adxl345-check-*.csv -o my.toml
    """
    from hframe_post.identification.check import runs
    from hframe_post.identification.recordings.runs import moves_sensor

    profile = load(printer)
    check_identified(profile)
    if gcode is not None:
        planned = runs(profile)
        jobs = {}
        if moves_sensor(profile, planned, chips):
            jobs = {
                gcode.with_name(f"{gcode.stem}-{'xy'[run.axis]}.gcode"): [run] for run in planned
            }
        write_motion(gcode, printer, profile, planned, chips, jobs)
        say(next_steps("check", gcode, printer, planned, list(jobs)))
    elif recordings:
        _update(printer, profile, recordings, json_file, output)
    else:
        _age(printer, profile, output)


def _update(
    printer: str, profile: Printer, recordings: tuple[Path, ...], json_file: Path | None,
    output: Path | None,
) -> None:  # fmt: skip
    from hframe_post.identification.check import CheckReport, drifts
    from hframe_post.identification.recordings.folder import files_in
    from hframe_post.identification.recordings.names import recorded_on

    files = files_in(recordings)
    sources = [*files_read(printer), *files]
    with Outputs(sources) as profiles:
        file = ModelOutput(profiles, output, printer) if output is not None else None
        with Outputs([*sources, *([output] if output else [])]) as reports:
            write_json = open_json(reports, json_file)
            gathered = _gathered(recordings, profile)
            runs = list({run.axes: run for run in gathered.runs}.values())  # the last of each
            labels = {label: path for path, label in files.items()}
            day = max(recorded_on(labels[run.name]) for run in runs)
            if profile.measured is not None and day < profile.measured:
                raise IdentificationError(
                    f"the recordings are of {day}, older than the model, of {profile.measured}: "
                    "print check.gcode and fetch the new files"
                )
            report = CheckReport(profile, drifts(profile.plant, runs), day)
            write_json(report.as_json())
        for one in gathered.aside:
            say(f"left aside   {one.label}: {one.reason}")
        click.echo(report.as_text(), err=str(json_file) == "-")
        if file is not None:
            measured = day if report.complete else profile.measured
            moved: dict[str, Any] = report.moved
            plant = replace(profile.plant, **moved)
            file.write(
                replace(profile, plant=plant, uncertainty=report.uncertainty, measured=measured)
            )


def _gathered(recordings: tuple[Path, ...], profile: Printer) -> Gathered:
    """Return the runs of `check`, sorted by date."""
    from hframe_post.identification.gather import from_folders
    from hframe_post.identification.recordings.folder import CHECK

    sweep = profile.sweep
    chips = {axis: chip.lower() for axis, chip in (("x", sweep.chip_x), ("y", sweep.chip_y))}
    found = from_folders(recordings, None, profile.travel, chips=chips, kinds=[CHECK])
    found = replace(found, runs=[run for run in found.runs if run.start])
    if not found.runs:
        raise IdentificationError(
            "no recording of the run that 'hframe-post check --gcode' writes. Give its recordings "
            "and its commands, such as check.check-at-150.csv"
        )
    return found


def _age(printer: str, profile: Printer, output: Path | None) -> None:
    if profile.measured is None:
        raise PrinterError(
            'the profile does not say when it was measured. Write the day, such as "2026-01-31"',
            "plant.measured", printer,
        )  # fmt: skip
    today: date = datetime.now(UTC).date()
    now, before = profile.uncertainty_on(today), profile.uncertainty or 0.0
    days = (today - profile.measured).days
    click.echo(f"measured     {profile.measured}, {days} days ago")
    click.echo(f"uncertainty  ±{100 * now:.1f} % ({100 * before:.1f} % in the profile)")
    if output is not None:
        with Outputs(files_read(printer)) as outputs:
            file = ModelOutput(outputs, output, printer)
            file.write(replace(profile, uncertainty=round(now, 4)))
