"""``hframe-post identify``: a profile of one's own printer, from sweeps it has played."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from hframe_post.cli.options import (
    files_read,
    json_option,
    open_json,
    page_option,
    position,
    printer_option,
)
from hframe_post.cli.sensing import FILE, QUIET, axes_option

if TYPE_CHECKING:
    from hframe_post.identification.identify import Identified, Run
    from hframe_post.identification.recordings.accelerometer import Recording
    from hframe_post.printer.settings import Printer
    from hframe_post.writers.files.atomic_file import Outputs

NO_WINDOW = (
    "no window and weight compensate this plant within the motors' limits, on every printer as "
    "like it as it is known; see tune --help"
)
PLACE = re.compile(r"(?<![A-Za-z0-9])([xy]-at-m?\d+(?:_\d+)?(?:-m?\d+(?:_\d+)?)?)(?![0-9_])")


def _columns(text: str) -> tuple[str, ...]:
    """``time,x,y,z``: four names."""
    names = tuple(name.strip() for name in text.split(","))
    if len(names) != 4 or not all(names):
        raise click.BadParameter(f"{text!r} is not four names, of time, x, y and z")
    return names


def _reading(text: str) -> tuple[float, float, float]:
    """The last three numbers of a line such as ACCELEROMETER_QUERY prints."""
    numbers = re.findall(r"[-+]?\d+(?:\.\d+)?", text)
    if len(numbers) < 3:
        raise click.BadParameter(f"{text!r} is not three numbers, of x, y and z")
    x, y, z = (float(number) for number in numbers[-3:])
    return x, y, z


def _order(text: str) -> tuple[str, int]:
    """``Gxx=4``: a transfer function and its order."""
    name, _, number = text.partition("=")
    if name not in ("Gxx", "Gyy", "Gxtheta") or not number.isdecimal() or not 0 < int(number) <= 20:
        raise click.BadParameter(f"{text!r} is not such as Gxx=4, of Gxx, Gyy or Gxtheta")
    return name, int(number)


@click.command()
@printer_option
@click.option(
    "-n", "--nozzle", type=(FILE, FILE), multiple=True, metavar="COMMAND RECORDING",
    help="A sweep that `sweep` wrote (.csv), and what the sensor on the nozzle recorded. "
    "Once per run; x and y are both needed.",
)  # fmt: skip
@click.option(
    "-b", "--bridge", type=(FILE, FILE, FILE), multiple=True, metavar="COMMAND P1 P2",
    help="A sweep of x, and what sensors on the bridge's ends recorded: P1 at the greater x.",
)  # fmt: skip
@click.option(
    "--bridge-length", "L_G", type=click.FloatRange(1.0), metavar="MM",
    help="Distance of P1 and P2, needed with --bridge.",
)  # fmt: skip
@axes_option
@click.option("--bridge-axes", default="x=x,y=y,z=z", show_default=True, metavar="MAP",
              help="The same of the sensors on the bridge.")  # fmt: skip
@click.option(
    "--columns", type=_columns, metavar="T,X,Y,Z",
    help="Names of time and accelerations in recordings that Klipper did not write.",
)  # fmt: skip
@click.option("--unit", type=click.Choice(["mm/s2", "m/s2", "g"]), default="mm/s2",
              show_default=True, help="Of those accelerations.")  # fmt: skip
@click.option(
    "--band", type=(float, float), default=(3.0, 100.0), show_default=True, metavar="HZ HZ",
    help="Frequencies that the model must explain.",
)  # fmt: skip
@click.option("--estimator", type=click.Choice(["H1", "H2", "Hv"]), default="H1",
              show_default=True, help="Of the frequency responses.")  # fmt: skip
@click.option(
    "--order", "orders", type=_order, multiple=True, metavar="NAME=N",
    help="Poles of Gxx, Gyy or Gxtheta, where the choice is not to be left to the tool.",
)  # fmt: skip
@click.option(
    "--at-rest", "readings", type=_reading, multiple=True, metavar="X,Y,Z",
    help="What ACCELEROMETER_QUERY prints; six times at least, each axis of the sensor pointing up "
    "once and down once. Gravity then tells the sensor's gains.",
)  # fmt: skip
@click.option("--x-c", type=float, metavar="MM",
              help="Where racking does not move the nozzle, if no run tells.")  # fmt: skip
@click.option(
    "--sensor-offset", "offset", type=position, default="0,0", show_default=True, metavar="X,Y",
    help="From the nozzle to its sensor, mm: a sensor beside the nozzle feels racking by another "
    "lever arm.",
)  # fmt: skip
@click.option(
    "--figures", "folder", type=click.Path(path_type=Path, file_okay=False), metavar="FOLDER",
    help="Draw what was measured and what the model makes of it (PNG and SVG); needs matplotlib.",
)  # fmt: skip
@page_option
@json_option
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="PROFILE.TOML",
    help="Write the profile: that of -p with the plant, the window and λ found.",
)  # fmt: skip
def identify(
    printer: str, nozzle: tuple[tuple[Path, Path], ...],
    bridge: tuple[tuple[Path, Path, Path], ...], L_G: float | None, axes: str, bridge_axes: str,
    columns: tuple[str, ...] | None, unit: str, band: tuple[float, float],
    estimator: Literal["H1", "H2", "Hv"], orders: tuple[tuple[str, int], ...],
    readings: tuple[tuple[float, float, float], ...],
    x_c: float | None, offset: tuple[float, float], folder: Path | None,
    report_file: Path | None, json_file: Path | None, output: Path | None,
) -> None:  # fmt: skip
    """Identify a printer's own model from sweeps recorded by accelerometers.

    One sensor on the nozzle is enough: runs of x at several places tell racking, too. Start
    from a profile (-p) that has your printer's travel and limits. Nothing is written if a
    recording cannot be trusted.

    \b
    Example:
      hframe-post identify -p my.toml -n x.csv x.recording.csv -n y.csv y.recording.csv -o my.toml
    """
    import numpy as np

    from hframe_post import plotting
    from hframe_post.errors import IdentificationError
    from hframe_post.identification.fitting.recommend import recommend
    from hframe_post.identification.identify import Settings
    from hframe_post.identification.identify import identify as identified
    from hframe_post.identification.page import identification_page
    from hframe_post.identification.recordings.gravity import along_printer, gains
    from hframe_post.identification.report import IdentificationReport
    from hframe_post.identification.responses.measured import STEP
    from hframe_post.printer.edit import with_plant
    from hframe_post.printer.profile import load
    from hframe_post.writers.files.atomic_file import Outputs

    profile = load(printer)
    _check_usage(nozzle, bridge, L_G, band)
    if folder is not None:
        plotting.ready(folder)
    reads = [*files_read(printer), *(path for files in (*nozzle, *bridge) for path in files)]
    with Outputs(reads) as model:
        file = model.open(output, Path(printer)) if output is not None else None
        with Outputs([*reads, *([output] if output else [])]) as findings:
            write_json = open_json(findings, json_file)
            drawn = findings.open(report_file) if report_file is not None else None
            reading = _Reading(axes, bridge_axes, columns, unit)
            runs = [reading.nozzle(*files) for files in nozzle]
            runs += [reading.bridge(*files) for files in bridge]
            _check_bed(runs, profile)
            racks, step = profile.kinematics.racks, profile.steps.belt if profile.steps else STEP
            sensor = along_printer(gains(np.array(readings)), axes) if readings else None
            settings = Settings(band, estimator, L_G, dict(orders), racks, offset, step, sensor)
            found = identified(runs, settings)
            if folder is not None:
                _draw(found, folder, findings)
            middle = sum(profile.travel.x) / 2.0 if x_c is None else x_c
            plant, elsewhere = found.plant(middle), found.plants_at_ends(middle)
            known = found.model_error
            compensation = None if found.refusal else recommend(plant, profile, known, elsewhere)
            report = IdentificationReport(
                found, plant, compensation, reading.setup, reading.findings
            )
            write_json(report.as_json())
            if drawn is not None:
                drawn.write(identification_page(report, profile.description or profile.name))
        click.echo(report.as_text(), err=str(json_file) == "-")
        if compensation is None:
            raise IdentificationError(found.refusal or NO_WINDOW)
        if file is not None:
            windows, notes = compensation.windows, report.origin()
            text = with_plant(printer, report.plant, windows, notes, round(known, 4))
            file.write(text.encode())


def _check_usage(
    nozzle: Sequence[object], bridge: Sequence[object], L_G: float | None, band: tuple[float, float]
) -> None:
    if not nozzle:
        raise click.UsageError("give at least one --nozzle run of x and one of y")
    if bridge and L_G is None:
        raise click.UsageError("--bridge needs --bridge-length")
    if not 0.0 < band[0] < band[1] < 500.0:
        raise click.UsageError("--band goes from a frequency above 0 to a higher one below 500 Hz")


def _check_bed(runs: Sequence[Run], profile: Printer) -> None:
    """Raises IdentificationError for a sweep that this profile's bed has no room for."""
    from hframe_post.errors import IdentificationError

    for run in runs:
        ranges = zip("xy", run.command.T, (profile.travel.x, profile.travel.y), strict=True)
        for axis, at, (low, high) in ranges:
            if at.min() < low or at.max() > high:
                raise IdentificationError(
                    f"{run.name}: its sweep goes from {at.min():.1f} to {at.max():.1f} mm in "
                    f"{axis}, the profile's travel from {low:g} to {high:g} mm: is it another "
                    "printer's?"
                )


def _check_names(command: Path, recording: Path) -> None:
    """Raises IdentificationError where both names tell a place, and not the same."""
    from hframe_post.errors import IdentificationError

    told = [PLACE.findall(path.stem) for path in (command, recording)]
    if all(told) and told[0][-1] != told[1][-1]:
        raise IdentificationError(
            f"{recording.name} is named as the recording of {told[1][-1]}, but given with the "
            f"command of {told[0][-1]}. Are the files of two places exchanged?"
        )


def _draw(found: Identified, folder: Path, outputs: Outputs) -> None:
    from hframe_post import plotting
    from hframe_post.identification import plots

    drawings = {
        name: plots.identification(name, found.measured[name], fitted)
        for name, fitted in found.fits.items()
    }
    plotting.save_all(drawings, lambda name: outputs.open(folder / name))


@dataclass
class _Reading:
    """How recordings are read; ``setup`` and ``findings`` collect what the report tells of them."""

    axes: str
    bridge_axes: str
    columns: tuple[str, ...] | None
    unit: str
    setup: list[str] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)

    def nozzle(self, command: Path, recording: Path) -> Run:
        """A run of the nozzle's sensor."""
        from hframe_post.identification.identify import Run
        from hframe_post.identification.recordings import command_file

        _check_names(command, recording)
        heard = self._recording(recording, self.axes)
        return Run(recording.name, command_file.read(command), heard)

    def bridge(self, command: Path, P1: Path, P2: Path) -> Run:
        """A run of the bridge's sensors."""
        from hframe_post.identification.identify import Run
        from hframe_post.identification.recordings import command_file

        ends = self._recording(P1, self.bridge_axes), self._recording(P2, self.bridge_axes)
        return Run(f"{P1.name}, {P2.name}", command_file.read(command), None, ends)

    def _recording(self, path: Path, axes: str) -> Recording:
        from hframe_post.identification.recordings import accelerometer

        read = accelerometer.read(path, self.columns, self.unit)
        self.findings += [f"{path.name}: {text}" for text in accelerometer.diagnose(read, QUIET)]
        digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        self.setup.append(f"  {path.name}, axes {axes}, sha256 {digest}")
        return accelerometer.oriented(read, axes, QUIET)
