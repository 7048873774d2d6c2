"""``hframe-post verify``: a test on the printer of whether its profile helps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hframe_post.cli.json_summary import json_option, open_json
from hframe_post.cli.model_output import ModelOutput
from hframe_post.cli.options import files_read, page_option, printer_option, say
from hframe_post.cli.sweep import (
    FILE,
    axes_option,
    chips_option,
    next_steps,
    recordings_argument,
    write_motion,
)
from hframe_post.errors import IdentificationError
from hframe_post.printer.profile import check_identified, load
from hframe_post.printer.settings import Verified
from hframe_post.writers.files import Outputs

if TYPE_CHECKING:  # which imports SciPy, as do the imports in functions: that takes a second
    from hframe_post.identification.verification.pairing import Run


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
@click.option(
    "--plain", type=(FILE, FILE), metavar="COMMAND RECORDING",
    help="The plain motion's command (.csv), and what the sensor on the nozzle recorded of it.",
)  # fmt: skip
@click.option(
    "--compensated", type=(FILE, FILE), metavar="COMMAND RECORDING",
    help="The same two files of the compensated motion.",
)  # fmt: skip
@axes_option
@chips_option
@page_option
@json_option
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="PROFILE.TOML",
    help="Write the profile, marked as verified, if the verdict is good.",
)  # fmt: skip
def verify(
    recordings: tuple[Path, ...], printer: str, gcode: Path | None, motion: Path | None,
    plain: tuple[Path, Path] | None, compensated: tuple[Path, Path] | None, axes: str | None,
    chips: tuple[str, ...], report_file: Path | None, json_file: Path | None, output: Path | None,
) -> None:  # fmt: skip
    """Check on the printer what a profile does: first --gcode, then both recordings.

    Put the recordings into one folder with the commands that --gcode wrote. Exits with status 1 if
    compensation does not help as the profile's model predicts. Otherwise it says whether the
    printer's modes have moved since they were measured, which 'hframe-post check' corrects.

    \b
    Example:
      hframe-post verify -p my.toml --gcode verify.gcode
      hframe-post verify -p my.toml recordings/ -o my.toml
    """
    from hframe_post.identification.recordings.accelerometer import read
    from hframe_post.identification.recordings.excitation import read_command
    from hframe_post.identification.recordings.folder import files_in
    from hframe_post.identification.verification.pairing import from_files

    if gcode is not None:
        _write(gcode, printer, motion, chips)
    elif recordings and plain is None and compensated is None:
        runs, files = from_files(recordings)
        _judge(printer, runs, files, list(files_in(recordings)), axes,
               report_file, json_file, output)  # fmt: skip
    elif plain is not None and compensated is not None:
        runs = [(read_command(command), read(path)) for command, path in (plain, compensated)]
        _judge(printer, runs, [plain[1], compensated[1]], [*plain, *compensated], axes,
               report_file, json_file, output)  # fmt: skip
    else:
        raise click.UsageError(
            "give --gcode, the folder with both recordings, or both --plain and --compensated"
        )


def _write(gcode: Path, printer: str, motion: Path | None, chips: tuple[str, ...]) -> None:
    from hframe_post.gcode.lines import lines_of
    from hframe_post.identification.verification.motion import runs

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
    printer: str, given: Sequence[Run], recorded: Sequence[Path], read_from: Sequence[Path],
    axes: str | None, report_file: Path | None, json_file: Path | None, output: Path | None,
) -> None:  # fmt: skip
    from hframe_post.identification.pages import verification_page
    from hframe_post.identification.recordings.names import recorded_on
    from hframe_post.identification.verification.drifted import as_text, drifted
    from hframe_post.identification.verification.pairing import along_printer, sorted_out
    from hframe_post.identification.verification.verdict import compare_runs

    profile = load(printer)
    sources = [*files_read(printer), *read_from]
    with Outputs(sources) as profiles:
        file = ModelOutput(profiles, output, printer) if output is not None else None
        with Outputs([*sources, *([output] if output else [])]) as reports:
            write_json = open_json(reports, json_file)
            html = reports.open(report_file) if report_file is not None else None
            first, second = (along_printer(run, axes) for run in given)
            plain, compensated, notes = sorted_out(profile, first, second)
            verdict = compare_runs(profile, plain, compensated)
            moved = {} if verdict.fault else drifted(profile, plain, compensated)
            left = {name: list(one.left) for name, one in moved.items()}
            fault = None
            if verdict.fault is not None:
                fault = IdentificationError(f"the profile is not verified: {verdict.fault}")
            write_json({**verdict.as_json(), "drifted": left, "notes": notes}, error=fault)
            if html is not None:
                setup = [("recordings", ", ".join(path.name for path in recorded))]
                setup += [("note", note) for note in notes]
                name = profile.description or profile.name
                html.write(verification_page(verdict, name, setup))
        for note in notes:
            say(f"WARNING     {note}")
        click.echo(verdict.as_text(), err=str(json_file) == "-")
        if fault is not None:
            raise fault
        click.echo(as_text(moved), err=str(json_file) == "-")
        if file is not None:
            day = max(map(recorded_on, recorded)).isoformat()
            mark = Verified(
                day, round(verdict.reduction, 4), profile.firmware.dialect, profile.model
            )
            file.write(replace(profile, verified=mark))
