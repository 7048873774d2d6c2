"""``hframe-post identify`` and ``check``: what recordings of a printer's motion say of it."""

from __future__ import annotations

import os
from dataclasses import replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hframe_post.cli.model_output import (
    Findings,
    Rows,
    profile_option,
    publish,
    recordings_argument,
)
from hframe_post.cli.parameters import READ, Summary, files_read, position, say, shared
from hframe_post.errors import IdentificationError, PrinterError
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.firmware.klipper.source import kinematics_in, text_from_klipper, warnings
from hframe_post.printer.choice import choose
from hframe_post.printer.model_file import measured
from hframe_post.printer.profile import check_identified, load, parse
from hframe_post.printer.settings import Verified

if TYPE_CHECKING:  # these import SciPy, as do the imports in functions: that takes a second
    from hframe_post.identification.gather import Gathered
    from hframe_post.printer.settings import Printer

NO_WINDOW = (
    "no setting compensates this printer within the motors' limits. If the motors can do more, "
    "raise belt_acceleration and belt_velocity below [motors], and identify again"
)


def _columns(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if len(names) != 4 or len(set(names)) != 4 or not all(names):
        raise click.BadParameter(f"{text!r} is not four names of columns, of time, x, y and z")
    return names


@click.command()
@recordings_argument
@click.option(
    "-p", "--printer", metavar="NAME|FILE",
    help="Profile to complete. Default: that of -o, if it exists, or a new one from --printer-cfg.",
)  # fmt: skip
@click.option(
    "--printer-cfg", "config_file", type=READ, metavar="FILE",
    help="Klipper's printer.cfg: it describes recordings of TEST_RESONANCES and, without -p, the "
    "printer.",
)  # fmt: skip
@click.option(
    "-n", "--nozzle", type=(READ, READ), multiple=True, metavar="COMMAND RECORDING",
    help="A command that 'measure' wrote, and its recording, where their names do not match. May "
    "be repeated.",
)  # fmt: skip
@click.option(
    "--columns", type=_columns, metavar="T,X,Y,Z",
    help="Names of time (s) and accelerations in recordings not written by Klipper.",
)  # fmt: skip
@click.option(
    "--band", type=(float, float), default=(3.0, 100.0), show_default=True, metavar="HZ HZ",
    help="Frequencies that the model must explain.", hidden=True,
)  # fmt: skip
@click.option(
    "--sensor-offset", "offset", type=position, default="0,0", metavar="X,Y",
    help="From the nozzle to its sensor, mm, which changes the lever arm of racking.", hidden=True,
)  # fmt: skip
@shared("report", "json")
@profile_option
@shared("help_all")
def identify(
    recordings: tuple[Path, ...], printer: str | None, config_file: Path | None,
    nozzle: tuple[tuple[Path, Path], ...], columns: tuple[str, ...] | None,
    band: tuple[float, float], offset: tuple[float, float], report_file: Path | None,
    summary: Summary, output: Path | None,
) -> None:  # fmt: skip
    """Compute a printer's model from recordings of its accelerometer.

    Give the folder with the recordings: those of 'measure' with their commands, Klipper's
    (TEST_RESONANCES with OUTPUT=raw_data), or Shake&Tune's. One sensor on the nozzle is enough.

    \b
    Example:
      hframe-post identify recordings/ --printer-cfg printer.cfg -o mine.toml
    """
    from hframe_post.identification.recordings.folder import files_in

    if not (recordings or nozzle):
        raise click.UsageError("give the folder with the recordings, or --nozzle COMMAND RECORDING")
    if not 0.0 < band[0] < band[1] < 500.0:
        raise click.UsageError("--band goes from a frequency above 0 to a higher one below 500 Hz")
    config = KlipperConfig(config_file) if config_file is not None else None
    for warning in warnings(config) if config is not None else ():
        say(f"WARNING      {warning}")
    source, text = _profile_source(printer, config, output)
    profile = load(source) if text is None else parse(text, "printer", source)
    files = files_in(recordings)

    def model() -> Findings:
        from hframe_post.identification.gather import gather
        from hframe_post.identification.identify import MeasurementSettings
        from hframe_post.identification.report import conclude

        gathered = gather(recordings, config, profile.travel, columns, pairs=nozzle)
        # a new profile's printer may be an H-bot: Klipper calls that corexy, too
        either = config is not None and text is not None and "hbot" in kinematics_in(config)
        settings = MeasurementSettings(band, profile.kinematics.racks or either, offset)
        report = conclude(gathered, profile, settings)
        found = Findings(report, page=lambda: report.page(profile.description or profile.name))
        if report.compensation is None:
            found.fault = IdentificationError(report.identified.refusal or NO_WINDOW)
            return found
        day, error = gathered.day(gathered.runs), round(report.identified.model_error, 4)
        updated = measured(profile, report.plant, error, day)
        if updated.kinematics != profile.kinematics and output is not None:
            say("note         it racks, so the profile's kinematics.type is hbot")
        found.printer = updated.with_windows(report.compensation.windows)
        found.notes = report.origin()
        return found

    sources = files_read(source, *files, *(path for pair in nozzle for path in pair))
    publish(model, sources, source, output, summary, report_file, text)


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


# ---------------------------------------------------------------------- check


@click.command()
@recordings_argument
@shared("printer", "json")
@profile_option
def check(
    recordings: tuple[Path, ...], printer: str, summary: Summary, output: Path | None
) -> None:  # fmt: skip
    """Read what 'measure --for check' recorded.

    A check takes 20 s, before a print or once a week. It updates the profile's model, says what
    compensation brings on the printer as it is now, and refuses recordings of another printer.
    Without recordings, the age of the model raises its uncertainty.

    \b
    Example:
      hframe-post measure --for check -p my.toml -o check.gcode
      hframe-post check -p my.toml check.check-*.csv adxl345-check-*.csv -o my.toml
    """
    profile = load(printer)
    check_identified(profile)
    files = list[Path]()
    if recordings:
        from hframe_post.identification.recordings.folder import files_in

        files = [*files_in(recordings)]

    def findings() -> Findings:
        return _drifted(recordings, profile) if recordings else _aged(printer, profile)

    publish(findings, files_read(printer, *files), printer, output, summary)


def _drifted(recordings: tuple[Path, ...], profile: Printer) -> Findings:
    """Return what has drifted, and the profile with the model and the uncertainty of that day."""
    from hframe_post.identification.check import judged

    gathered = _gathered(recordings, profile)
    runs = list({run.axes: run for run in gathered.runs}.values())  # the last of each
    day = gathered.day(runs)
    if profile.measured is not None and day < profile.measured:
        raise IdentificationError(
            f"the recordings are of {day}, older than the model, of {profile.measured}: "
            "print check.gcode and fetch the new files"
        )
    report = judged(profile, runs, day)
    moved: dict[str, Any] = report.moved
    verified = profile.verified
    if report.effect is not None and not moved:
        brought = round(report.effect.reduction, 4)
        verified = Verified(day.isoformat(), brought, profile.firmware.dialect, profile.model)
    updated = replace(
        profile,
        plant=replace(profile.plant, **moved),
        uncertainty=report.uncertainty,
        measured=day if report.complete else profile.measured,
        verified=verified,
    )
    aside = [f"{one.label}: {one.reason}" for one in gathered.aside]
    return Findings(report, updated, aside=aside)


def _gathered(recordings: tuple[Path, ...], profile: Printer) -> Gathered:
    """Return the runs of `check`, sorted by date."""
    from hframe_post.identification.gather import gather
    from hframe_post.identification.recordings.folder import CHECK

    sweep = profile.sweep
    chips = {axis: chip.lower() for axis, chip in (("x", sweep.chip_x), ("y", sweep.chip_y))}
    found = gather(recordings, None, profile.travel, chips=chips)
    found = replace(found, used=[one for one in found.used if one.kind == CHECK])
    if not found.used:
        raise IdentificationError(
            "no recording of the run that 'hframe-post measure --for check' writes. Give its "
            "recordings and its commands, such as check.check-at-150.csv"
        )
    return found


def _aged(printer: str, profile: Printer) -> Findings:
    """Return the uncertainty of the model today, by its age."""
    if profile.measured is None:
        raise PrinterError(
            'the profile does not say when it was measured. Write the day, such as "2026-01-31"',
            "plant.measured", printer,
        )  # fmt: skip
    today: date = datetime.now(UTC).date()
    now, before = profile.uncertainty_on(today), profile.uncertainty or 0.0
    days = (today - profile.measured).days
    rows = [
        ("measured", f"{profile.measured}, {days} days ago"),
        ("uncertainty", f"±{100 * now:.1f} % ({100 * before:.1f} % in the profile)"),
    ]
    values = {"measured": profile.measured.isoformat(), "uncertainty": round(now, 4)}
    return Findings(Rows(rows, values), replace(profile, uncertainty=round(now, 4)))
