"""``hframe-post check``: what has drifted since a profile was identified, and what it brings."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hframe_post.cli.json_summary import json_option
from hframe_post.cli.model_output import (
    Findings,
    ModelOutput,
    profile_option,
    publish,
    recordings_argument,
)
from hframe_post.cli.parameters import files_read, printer_option
from hframe_post.errors import IdentificationError, PrinterError
from hframe_post.printer.profile import check_identified, load
from hframe_post.printer.settings import Verified
from hframe_post.writers.outputs import Outputs

if TYPE_CHECKING:  # which imports SciPy, as do the imports in functions: that takes a second
    from hframe_post.identification.gather import Gathered
    from hframe_post.printer.settings import Printer


@click.command()
@recordings_argument
@printer_option
@json_option
@profile_option
def check(
    recordings: tuple[Path, ...], printer: str, json_file: Path | None, output: Path | None
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
    if not recordings:
        _age(printer, profile, output)
        return
    from hframe_post.identification.recordings.folder import files_in

    publish(
        lambda: _drifted(recordings, profile), [*files_read(printer), *files_in(recordings)],
        printer, output, json_file,
    )  # fmt: skip


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
    from hframe_post.identification.gather import from_folders
    from hframe_post.identification.recordings.folder import CHECK

    sweep = profile.sweep
    chips = {axis: chip.lower() for axis, chip in (("x", sweep.chip_x), ("y", sweep.chip_y))}
    found = from_folders(recordings, None, profile.travel, chips=chips)
    found = replace(found, used=[one for one in found.used if one.kind == CHECK])
    if not found.used:
        raise IdentificationError(
            "no recording of the run that 'hframe-post measure --for check' writes. Give its "
            "recordings and its commands, such as check.check-at-150.csv"
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
