"""``hframe-post bands``: which speeds the motors do not like."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hframe_post.cli.json_summary import json_option, open_json
from hframe_post.cli.model_output import ModelOutput
from hframe_post.cli.options import files_read, printer_option, quoted, say
from hframe_post.cli.sweep import HEIGHT, chips_option, recordings_argument
from hframe_post.errors import IdentificationError
from hframe_post.printer.profile import load
from hframe_post.writers.outputs import Outputs

if TYPE_CHECKING:  # which imports SciPy, as do the imports in functions: that takes a second
    from hframe_post.printer.settings import Printer


@click.command()
@recordings_argument
@printer_option
@click.option(
    "--gcode", type=click.Path(path_type=Path, dir_okay=False), metavar="BANDS.GCODE",
    help="Write strokes at one speed after the other, which Klipper records; about 10 minutes.",
)  # fmt: skip
@chips_option
@json_option
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="PROFILE.TOML",
    help="Write the profile with the bands as speed.avoid.",
)  # fmt: skip
def bands(
    recordings: tuple[Path, ...], printer: str, gcode: Path | None, chips: tuple[str, ...],
    json_file: Path | None, output: Path | None,
) -> None:  # fmt: skip
    """Find the motor speeds at which the nozzle shakes: first --gcode, then the recordings.

    A motor shakes the nozzle most where its steps meet a resonance, and leaves fine vertical lines
    on outer walls. With the bands that are found, speed.avoid of the profile, 'hframe-post convert'
    keeps both motors out of them on outer walls. Recordings of Shake&Tune's
    CREATE_VIBRATIONS_PROFILE do as well.

    \b
    Example:
      hframe-post bands -p my.toml --gcode bands.gcode
      hframe-post bands -p my.toml recordings -o my.toml
    """
    profile = load(printer)
    if gcode is not None:
        _write(gcode, printer, profile, chips)
    elif recordings:
        _find(recordings, printer, profile, json_file, output)
    else:
        raise click.UsageError(
            "give the recordings, or --gcode BANDS.GCODE to write what Klipper records"
        )


def _write(target: Path, printer: str, profile: Printer, chips: tuple[str, ...]) -> None:
    from hframe_post.identification.bands import gcode, runs, seconds_of, sensors_of
    from hframe_post.writers.print_time import duration

    planned = runs(profile)
    sensors = {chip for run in planned for chip in chips or sensors_of(profile, run)}
    jobs = {target: planned}
    if profile.kinematics.bed_moves and len(sensors) == 1:
        jobs = {
            target.with_name(f"{target.stem}-{axis}.gcode"): [run]
            for axis, run in zip("xy", planned, strict=True)
        }
    with Outputs(files_read(printer)) as outputs:
        for file, some in jobs.items():
            outputs.open(file).writelines(gcode(profile, some, chips, HEIGHT))
    count, names = (
        sum(len(run.strokes) for run in planned),
        " and ".join(path.name for path in jobs),
    )
    moved = " with the sensor on the head, then on the bed" if len(jobs) > 1 else ""
    folder = quoted(target.parent / "bands")
    say(
        f"{count} recordings in {duration(seconds_of(planned))} of motion\n"
        f"Next, home the printer, print {names}{moved}, and fetch what Klipper recorded:\n"
        f'  mkdir {folder}; scp "pi@printer.local:/tmp/*-vib_an*.csv" {folder}\n'
        "Then type\n"
        f"  hframe-post bands -p {quoted(printer)} {folder} -o {quoted(printer)}"
    )


def _find(
    recordings: tuple[Path, ...], printer: str, profile: Printer, json_file: Path | None,
    output: Path | None,
) -> None:  # fmt: skip
    from hframe_post.identification.bands import BandsReport, shaking

    sources = [*files_read(printer), *recordings]
    with Outputs(sources) as profiles:
        file = ModelOutput(profiles, output, printer) if output is not None else None
        with Outputs([*sources, *([output] if output else [])]) as reports:
            write_json = open_json(reports, json_file)
            motors, aside = shaking(recordings, profile.kinematics)
            report = BandsReport.from_motors(motors)
            write_json(report.as_json())
        for one in aside:
            say(f"left aside   {one.label}: {one.reason}")
        click.echo(report.as_text(), err=str(json_file) == "-")
        if file is not None:
            if not report.avoid:
                raise IdentificationError("no band was found, so the profile was not changed")
            avoid = tuple((float(low), float(high)) for low, high in report.avoid)
            file.write(replace(profile, speed=replace(profile.speed, avoid=avoid)))
