"""``hframe-post identify``: a profile of your own printer, from recordings of its motion."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hframe_post.cli.json_summary import json_option, open_json
from hframe_post.cli.model_output import ModelOutput
from hframe_post.cli.options import (
    files_read,
    old_option,
    page_option,
    position,
)
from hframe_post.cli.sweep import FILE
from hframe_post.errors import IdentificationError
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.firmware.klipper.settings import kinematics_in, text_from_klipper, warnings
from hframe_post.printer.choice import choose
from hframe_post.printer.model_file import measured, with_windows
from hframe_post.printer.profile import load, parse
from hframe_post.writers.outputs import Outputs

if TYPE_CHECKING:  # these import SciPy, which takes a second
    from hframe_post.identification.identify import MeasurementSettings
    from hframe_post.printer.settings import Printer

NO_WINDOW = (
    "no window and weight compensate this plant within the motors' limits on every printer that "
    "may differ from it by the model uncertainty. See 'hframe-post tune --help'"
)


def _columns(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if len(names) != 4 or not all(names):
        raise click.BadParameter(f"{text!r} is not four names, of time, x, y and z")
    return names


@click.command()
@click.argument(
    "recordings",
    nargs=-1,
    metavar="[FOLDER|FILES]...",
    type=click.Path(path_type=Path, exists=True),
)
@click.option(
    "-p",
    "--printer",
    metavar="NAME|FILE",
    help="Profile to complete. Default: that of -o if it exists, a new one from --printer-cfg, or "
    "the default profile.",
)
@click.option(
    "--printer-cfg", "config_file", type=FILE, metavar="FILE",
    help="Klipper's printer.cfg: it describes the tests that were recorded and, without -p, the "
    "printer.",
)  # fmt: skip
@click.option(
    "-n", "--nozzle", type=(FILE, FILE), multiple=True, metavar="COMMAND RECORDING",
    help="A command (.csv, written by `sweep`), and what the sensor on the nozzle recorded "
    "of it, where their names do not show that they belong together. May be repeated.",
)  # fmt: skip
@old_option("--axes", "the recordings show how the sensor is mounted")
@click.option(
    "--columns", type=_columns, metavar="T,X,Y,Z",
    help="Names of time (s) and accelerations in recordings not written by Klipper.",
)  # fmt: skip
@click.option(
    "--band", type=(float, float), default=(3.0, 100.0), show_default=True, metavar="HZ HZ",
    help="Frequencies that the model must explain.",
)  # fmt: skip
@click.option(
    "--sensor-offset", "offset", type=position, default="0,0", show_default=True, metavar="X,Y",
    help="From the nozzle to its sensor in mm. A sensor next to the nozzle measures racking with "
    "another lever arm.",
)  # fmt: skip
@page_option
@json_option
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="PROFILE.TOML",
    help="Write the profile: that of -p, or this file if it exists, or a new one made from "
    "--printer-cfg, with the plant and the window found.",
)  # fmt: skip
def identify(
    recordings: tuple[Path, ...], printer: str | None, config_file: Path | None,
    nozzle: tuple[tuple[Path, Path], ...], columns: tuple[str, ...] | None,
    band: tuple[float, float], offset: tuple[float, float], report_file: Path | None,
    json_file: Path | None, output: Path | None,
) -> None:  # fmt: skip
    """Identify a printer's own model from recordings of its accelerometer.

    Give the folder with the recordings: those of `measure` or `sweep` with their commands,
    Klipper's (TEST_RESONANCES with OUTPUT=raw_data), or Shake&Tune's. One sensor on the nozzle is
    enough. The summary says what was used, and what was left aside and why. No profile is written
    if a recording cannot be trusted.

    \b
    Example:
      hframe-post identify recordings/ --printer-cfg printer.cfg -o mine.toml
    """
    from hframe_post.identification.gather import gather
    from hframe_post.identification.pages import identification_page
    from hframe_post.identification.recordings.folder import files_in
    from hframe_post.identification.recordings.names import recorded_on
    from hframe_post.identification.report import conclude

    _check_usage([*recordings, *nozzle], band)
    config = KlipperConfig(config_file) if config_file is not None else None
    for warning in warnings(config) if config is not None else ():
        click.echo(f"WARNING      {warning}", err=True)
    source, text = _profile_source(printer, config, output)
    profile = load(source) if text is None else parse(text, "printer", source)
    pairs = [path for files in nozzle for path in files]
    sources = [*files_read(source, *files_in(recordings)), *pairs]
    with Outputs(sources) as profiles:
        file = ModelOutput(profiles, output, source, text) if output is not None else None
        with Outputs([*sources, *([output] if output else [])]) as reports:
            write_json = open_json(reports, json_file)
            html = reports.open(report_file) if report_file is not None else None
            gathered = gather(recordings, nozzle, config, profile.travel, columns)
            settings = _settings(profile, config if text else None, band, offset)
            report = conclude(gathered, profile, settings)
            write_json(report.as_json())
            if html is not None:
                html.write(identification_page(report, profile.description or profile.name))
        click.echo(report.as_text(), err=str(json_file) == "-")
        if report.compensation is None:
            raise IdentificationError(report.identified.refusal or NO_WINDOW)
        if file is not None:
            day = max(recorded_on(one.path) for one in gathered.used)
            error = round(report.identified.model_error, 4)
            found = measured(profile, report.plant, error, day)
            file.write(with_windows(found, report.compensation.windows), report.origin())
            if found.kinematics != profile.kinematics:
                click.echo(
                    "note         it racks, so the profile's kinematics.type is hbot", err=True
                )


def _profile_source(
    printer: str | None, config: KlipperConfig | None, output: Path | None
) -> tuple[str, str | None]:
    """Return the profile to complete: its name or file, and its text if it is in no file yet.

    The output is completed if it exists, so that it keeps what `setup` and its owner wrote.
    """
    if printer is None and config is not None:
        if output is not None and output.is_file():
            return str(output), None
        return str(config.path), text_from_klipper(config)
    return choose(printer, os.environ).profile, None


def _settings(
    profile: Printer,
    config: KlipperConfig | None,
    band: tuple[float, float],
    offset: tuple[float, float],
) -> MeasurementSettings:
    from hframe_post.identification.identify import MeasurementSettings

    # config: of a new profile, whose printer may be an H-bot: Klipper calls that corexy, too
    racks = profile.kinematics.racks or (config is not None and "hbot" in kinematics_in(config))
    return MeasurementSettings(band, racks, offset)


def _check_usage(given: Sequence[object], band: tuple[float, float]) -> None:
    if not given:
        raise click.UsageError("give the folder with the recordings, or --nozzle COMMAND RECORDING")
    if not 0.0 < band[0] < band[1] < 500.0:
        raise click.UsageError("--band goes from a frequency above 0 to a higher one below 500 Hz")
