"""``hframe-post identify``: a profile of your own printer, from sweeps that it has played."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import click
import numpy as np

from hframe_post.cli.options import (
    files_read,
    json_option,
    old_option,
    open_json,
    page_option,
    position,
    printer_option,
)
from hframe_post.cli.sweep import FILE, QUIET
from hframe_post.errors import IdentificationError
from hframe_post.identification.identify import Run, Settings
from hframe_post.identification.identify import identify as identified
from hframe_post.identification.recommend import recommend
from hframe_post.identification.recordings import accelerometer
from hframe_post.identification.recordings.excitation import read_command
from hframe_post.identification.report import IdentificationReport, identification_page
from hframe_post.printer.edit import with_plant
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from hframe_post.writers.files import Outputs

SAME_AXES = "x=x,y=y,z=z"
NO_WINDOW = (
    "no window and weight compensate this plant within the motors' limits on every printer that "
    "may differ from it by the model uncertainty. See 'hframe-post tune --help'"
)


def _columns(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if len(names) != 4 or not all(names):
        raise click.BadParameter(f"{text!r} is not four names, of time, x, y and z")
    return names


def _reading(text: str) -> tuple[float, float, float]:
    numbers = re.findall(r"[-+]?\d+(?:\.\d+)?", text)
    if len(numbers) < 3:
        raise click.BadParameter(f"{text!r} is not three numbers, of x, y and z")
    x, y, z = (float(number) for number in numbers[-3:])
    return x, y, z


@click.command()
@printer_option
@click.option(
    "-n", "--nozzle", type=(FILE, FILE), multiple=True, metavar="COMMAND RECORDING",
    help="A sweep's command (.csv, written by `sweep`), and what the sensor on the nozzle recorded "
    "of it. Repeat for each run; x and y are both needed.",
)  # fmt: skip
@click.option(
    "-b", "--bridge", type=(FILE, FILE, FILE), multiple=True, metavar="COMMAND P1 P2",
    help="The command of a sweep of x, and the recordings of sensors at the ends of the bridge; P1 "
    "is at the greater x.",
)  # fmt: skip
@click.option(
    "--bridge-length", "L_G", type=click.FloatRange(1.0), metavar="MM",
    help="Distance of P1 and P2, needed with --bridge.",
)  # fmt: skip
@click.option(
    "--axes", multiple=True, metavar="MAP",
    help="The printer's axes as the nozzle's sensor names them, such as x=-y,y=x,z=z. A second "
    f"--axes is for the sensors on the bridge.  [default: {SAME_AXES}]",
)  # fmt: skip
@click.option(
    "--columns", type=_columns, metavar="T,X,Y,Z",
    help="Names of time (s) and accelerations in recordings not written by Klipper.",
)  # fmt: skip
@click.option(
    "--band", type=(float, float), default=(3.0, 100.0), show_default=True, metavar="HZ HZ",
    help="Frequencies that the model must explain.",
)  # fmt: skip
@click.option(
    "--at-rest", "readings", type=_reading, multiple=True, metavar="X,Y,Z",
    help="A reading of ACCELEROMETER_QUERY. Give at least six, each axis of the sensor pointing up "
    "once and down once: gravity then calibrates the sensor.",
)  # fmt: skip
@click.option("--x-c", type=float, metavar="MM",
              help="Where racking does not move the nozzle, if no run shows it.")  # fmt: skip
@click.option(
    "--sensor-offset", "offset", type=position, default="0,0", show_default=True, metavar="X,Y",
    help="From the nozzle to its sensor in mm. A sensor next to the nozzle measures racking with "
    "another lever arm.",
)  # fmt: skip
@page_option
@json_option
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="PROFILE.TOML",
    help="Write the profile: that of -p with the plant, the window and λ found.",
)  # fmt: skip
@old_option("--unit", "gravity in the recording shows its unit",
                 type=click.Choice(["mm/s2", "m/s2", "g"]))  # fmt: skip
@old_option("--bridge-axes", "give --axes twice, first the nozzle's, then the bridge's",
                 metavar="MAP")  # fmt: skip
@old_option("--figures", "use --report page.html", removed=True)
@old_option("--estimator", "the estimator is always H1", removed=True)
@old_option("--order", "the recordings determine the order", removed=True, multiple=True)
def identify(
    printer: str, nozzle: tuple[tuple[Path, Path], ...],
    bridge: tuple[tuple[Path, Path, Path], ...], L_G: float | None, axes: tuple[str, ...],
    columns: tuple[str, ...] | None, band: tuple[float, float],
    readings: tuple[tuple[float, float, float], ...], x_c: float | None,
    offset: tuple[float, float], report_file: Path | None, json_file: Path | None,
    output: Path | None, unit: str | None, bridge_axes: str | None,
) -> None:  # fmt: skip
    """Identify a printer's own model from sweeps recorded by accelerometers.

    One sensor on the nozzle is enough: runs of x at several places show racking, too. Start
    from a profile (-p) that has your printer's travel and limits. No profile is written if a
    recording cannot be trusted.

    \b
    Example:
      hframe-post identify -p my.toml -n x.csv x.recording.csv -n y.csv y.recording.csv -o my.toml
    """
    profile = load(printer)
    _check_usage(nozzle, bridge, L_G, band, axes)
    nozzle_axes, second_axes = (*axes, SAME_AXES, SAME_AXES)[:2]
    reader = _Reader(nozzle_axes, bridge_axes or second_axes, columns, unit)
    sources = [*files_read(printer), *(path for files in (*nozzle, *bridge) for path in files)]
    with Outputs(sources) as profiles:
        file = profiles.open(output, Path(printer)) if output is not None else None
        with Outputs([*sources, *([output] if output else [])]) as reports:
            write_json = open_json(reports, json_file)
            html = reports.open(report_file) if report_file is not None else None
            runs = [reader.run(*files) for files in (*nozzle, *bridge)]
            _check_travel(runs, profile)
            settings = Settings(band, L_G, profile.kinematics.racks, offset)
            if profile.steps:
                settings = replace(settings, step=profile.steps.belt)
            if readings:
                gains = accelerometer.gains_at_rest(np.array(readings))
                along = accelerometer.gains_along_printer(gains, nozzle_axes)
                settings = replace(settings, sensor=along)
            found = identified(runs, settings)
            middle = sum(profile.travel.x) / 2.0 if x_c is None else x_c
            plant, error = found.plant(middle), found.model_error
            compensation = None
            if found.refusal is None:
                compensation = recommend(plant, profile, error, found.other_plants(middle))
            report = IdentificationReport(found, plant, compensation, reader.setup, reader.findings)
            write_json(report.as_json())
            if html is not None:
                html.write(identification_page(report, profile.description or profile.name))
        click.echo(report.as_text(), err=str(json_file) == "-")
        if compensation is None:
            raise IdentificationError(found.refusal or NO_WINDOW)
        if file is not None:
            windows, notes = compensation.windows, report.origin()
            text = with_plant(printer, report.plant, windows, notes, round(error, 4))
            file.write(text.encode())


def _check_usage(
    nozzle: Sequence[object], bridge: Sequence[object], L_G: float | None,
    band: tuple[float, float], axes: Sequence[str],
) -> None:  # fmt: skip
    if not nozzle:
        raise click.UsageError("give at least one --nozzle run of x and one of y")
    if bridge and L_G is None:
        raise click.UsageError("--bridge needs --bridge-length")
    if not 0.0 < band[0] < band[1] < 500.0:
        raise click.UsageError("--band goes from a frequency above 0 to a higher one below 500 Hz")
    if len(axes) > 2:
        raise click.UsageError("give --axes at most twice: the nozzle's, then the bridge's")


def _check_travel(runs: Sequence[Run], profile: Printer) -> None:
    for run in runs:
        ranges = zip("xy", run.command.T, (profile.travel.x, profile.travel.y), strict=True)
        for axis, at, (low, high) in ranges:
            if at.min() < low or at.max() > high:
                raise IdentificationError(
                    f"{run.name}: its sweep goes from {at.min():.1f} to {at.max():.1f} mm in "
                    f"{axis}, but the profile's travel from {low:g} to {high:g} mm. Was it played "
                    "on another printer?"
                )


@dataclass
class _Reader:
    """Reader of recordings; ``setup`` and ``findings`` collect remarks for the report."""

    nozzle_axes: str
    bridge_axes: str
    columns: tuple[str, ...] | None
    unit: str | None
    setup: list[str] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)

    def run(self, command: Path, *files: Path) -> Run:
        """Return a run with one recording of the nozzle, or with two of the bridge's ends."""
        axes = self.nozzle_axes if len(files) == 1 else self.bridge_axes
        recordings = [self._recording(path, axes) for path in files]
        name, motion = ", ".join(path.name for path in files), read_command(command)
        if len(recordings) == 1:
            return Run(name, motion, recordings[0])
        return Run(name, motion, None, (recordings[0], recordings[1]))

    def _recording(self, path: Path, axes: str) -> accelerometer.Recording:
        read = accelerometer.read(path, self.columns, self.unit)
        self.findings += [f"{path.name}: {text}" for text in accelerometer.diagnose(read, QUIET)]
        digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        self.setup.append(f"  {path.name}, axes {axes}, sha256 {digest}")
        return accelerometer.oriented(read, axes, QUIET)
