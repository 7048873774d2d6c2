"""``hframe-post convert``: convert a sliced file."""

from __future__ import annotations

import math
import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import click

from hframe_post import library
from hframe_post.cli.json_summary import json_option, open_json
from hframe_post.cli.options import (
    chosen_printer,
    compensation_option,
    dashed,
    extrusion_option,
    files_read,
    force_option,
    limits_option,
    log,
    number,
    on_limit_option,
    printer_option,
    progress_bar,
    say,
    verbose_option,
)
from hframe_post.cli.speed import speed_from_options, speed_options
from hframe_post.conversion.files import FORMATS, GCODE, chosen_format
from hframe_post.conversion.pipeline import TOLERANCE, Retract
from hframe_post.errors import HframeError, LeftAloneError, one_line
from hframe_post.firmware.registry import FIRMWARES
from hframe_post.firmware.registry import firmware as firmware_of
from hframe_post.gcode.state import Extrusion, LimitSource
from hframe_post.model.strategies import STRATEGIES
from hframe_post.printer.choice import verification_as_text
from hframe_post.printer.profile import played_by
from hframe_post.printer.settings import Limits, Printer
from hframe_post.process import processor_count
from hframe_post.stream.running import keep_memory
from hframe_post.writers.files import Outputs

# in PrusaSlicer and OrcaSlicer: the slicer's name for the file, which is a temporary one by now
OUTPUT_NAME = "SLIC3R_PP_OUTPUT_NAME"


@click.command()
@click.argument("source", metavar="IN.GCODE", type=click.Path(path_type=Path, allow_dash=True))
@click.argument("more", nargs=-1, metavar="")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, allow_dash=True, dir_okay=False),
    help="Output file; '-' for standard output. Default: replace the input.",
)  # fmt: skip
@click.option(
    "--format", "format_name", type=click.Choice(tuple(FORMATS)),
    help="Output format: G-code (bgcode: Prusa's binary form), motor steps (a row per step, or a "
    "bit per clock tick), or samples every millisecond. Default: by the suffix of the output: .csv "
    "steps, .npz samples, .bgcode binary, any other G-code.",
)  # fmt: skip
@printer_option
@compensation_option
@click.option(
    "--firmware", type=click.Choice(tuple(FIRMWARES)),
    help="Firmware that plays the G-code. Default: firmware.dialect of the profile.",
)  # fmt: skip
@limits_option
@extrusion_option
@on_limit_option
@force_option
@click.option(
    "--tolerance", type=float, show_default=str(TOLERANCE), metavar="MM",
    help="How far G-code for Klipper may differ from the computed motion, at most 0.1 mm; 0 writes "
    "a line for every millisecond, and begins lifts at rest.",
)  # fmt: skip
@click.option(
    "--retract", type=click.Choice(["standing", "moving"]), default="standing", show_default=True,
    help="For Klipper: retract before the travel as in the file, or during it where there is time.",
)  # fmt: skip
@click.option(
    "--predict", type=click.Choice(["chosen", "all", "off"]), default="chosen", show_default=True,
    help="Contour errors to predict: without compensation and with the chosen one, with all, or "
    "none.",
)  # fmt: skip
@speed_options
@click.option(
    "--jobs", type=click.IntRange(1), metavar="N",
    help="Number of processes that compute G-code; the output does not depend on it. Default: one "
    "per processor.",
)  # fmt: skip
@json_option
@click.option(
    "--report", "report_file", metavar="FILE",
    type=click.Path(path_type=Path, allow_dash=True, dir_okay=False),
    help="Write the summary as text, '-' for standard output; or, if the name ends in .html, a "
    "report for a browser with the error along each layer.",
)  # fmt: skip
@click.option("-n", "--dry-run", is_flag=True, help="Print the summary, but write no G-code.")
@verbose_option
@click.option("-q", "--quiet", is_flag=True, help="Print no summary and no progress bar.")
def convert(
    source: Path, more: tuple[str, ...], output: Path | None, format_name: str | None, printer: str,
    firmware: str | None, compensation: str | None, limits: LimitSource,
    extrusion: Extrusion | None, on_limit: str, force: bool, tolerance: float | None,
    retract: Retract, predict: str, max_error: dict[str, float] | None, speed_up: float | None,
    jobs: int | None, json_file: Path | None, report_file: Path | None, dry_run: bool, quiet: bool,
) -> None:  # fmt: skip
    """Convert a sliced file. '-' reads standard input.

    The commands are changed so that the nozzle, rather than the motors, follows the slicer's path,
    as the model in the printer's profile predicts. Exit status: 0 for success, 1 for an error in
    the file or the profile (nothing is written then), 2 for wrong usage. A file that was converted
    with the same profile and options, or has a line '; hframe-post: off', is left as it is.

    \b
    Examples:
      hframe-post in.gcode -o out.gcode -p my.toml
      hframe-post in.gcode --report report.html
    """
    if more:
        raise click.UsageError(
            f"one file at a time: for another output use -o {more[0]}, for many files "
            "'hframe-post batch'"
        )
    to_stdout = str(output) == "-" or (output is None and str(source) == "-")
    html = report_file is not None and report_file.suffix == ".html"
    if [to_stdout, str(json_file) == "-", str(report_file) == "-"].count(True) > 1:
        raise click.UsageError("only one of output, JSON and report can go to standard output")
    if html and str(source) == "-":
        raise click.UsageError("an HTML report reads the file twice: name a file instead of '-'")
    profile = library.load_printer(printer)
    strategy = compensation or profile.compensation.strategy
    kind = _format(source, output, format_name)
    if kind not in GCODE and output is None and not (to_stdout or dry_run):
        raise click.UsageError(f"{kind} would replace the G-code: name an output file with -o")
    if tolerance is not None:
        _check_tolerance(tolerance, kind, profile, firmware)
    choice = chosen_printer()
    name_in_slicer = os.environ.get(OUTPUT_NAME)
    head = [choice.as_text(), *verification_as_text(profile)]
    # the paper's printer may be shown, but not in place: so do slicers what they print
    force = force or (choice.demonstrates and output is not None and name_in_slicer is None)
    if name_in_slicer:
        head.insert(0, f"file             {one_line(name_in_slicer)}")
    head += slicer_warnings(os.environ, profile.limits)
    log(f"profile {printer}, strategy {strategy}")
    keep_memory()
    with (
        _leaving_alone(source, None if dry_run else output, json_file, html, quiet),
        Outputs(files_read(source, printer)) as outputs,
        progress_bar(source, quiet) as advance,
    ):
        write_json = open_json(outputs, json_file)
        text_file = outputs.open(dashed(report_file)) if report_file and not html else None
        report = library.convert(
            source if str(source) != "-" else sys.stdin.buffer,
            None if dry_run else "-" if to_stdout else output or source,
            profile,
            format=format_name,
            firmware=firmware,
            strategy=strategy,
            predict={"chosen": None, "all": STRATEGIES, "off": ()}[predict],
            limits=limits,
            extrusion=extrusion,
            clamp=on_limit == "clamp",
            tolerance=TOLERANCE if tolerance is None else tolerance or None,
            retract=retract,
            speed=speed_from_options(profile, source, max_error, speed_up),
            force=force,
            jobs=jobs or processor_count(),
            page=report_file if html else None,
            title=one_line(Path(name_in_slicer or source).name),
            notes=head,
            outputs=outputs,
            progress=advance,
        )
        log(f"{report.read.lines} lines are converted")
        total = sum(report.seconds.values())
        for stage, spent in report.seconds.items():
            share = 100.0 * spent / total
            log(f"  {stage:12s}{spent:8.3f} s of the processor{share:6.1f} %")
        write_json({**choice.as_json(), **report.as_json()})
        text = report.summary(head)
        if text_file is not None:
            text_file.write(text.encode() + b"\n")
    log("all files are written")
    if not quiet:
        say(text)


@contextmanager
def _leaving_alone(
    source: Path, output: Path | None, json_file: Path | None, html: bool, quiet: bool
) -> Iterator[None]:
    """Copy a file that is not to be converted to the output, say so, and end the command."""
    try:
        yield
    except LeftAloneError as found:
        if html or not source.is_file():
            raise
        with Outputs(files_read(source)) as outputs, source.open("rb") as file:
            open_json(outputs, json_file)({"left_alone": str(found)})
            if output is not None and not (output.exists() and output.samefile(source)):
                shutil.copyfileobj(file, outputs.open(dashed(output), source))
        if not quiet:
            say(f"{source}: {found.cause}; left as it is")
        raise click.exceptions.Exit(0) from None


def _format(source: Path, output: Path | None, name: str | None) -> str:
    path = None if str(output) == "-" else output
    try:
        return chosen_format(path, name, source if output is None else None)
    except HframeError as error:
        raise click.UsageError(str(error)) from None


def _check_tolerance(tolerance: float, kind: str, profile: Printer, firmware: str | None) -> None:
    if not (tolerance == 0.0 or 1e-4 <= tolerance <= 0.1):
        raise click.UsageError(f"--tolerance must be 0, or from 0.0001 to 0.1, not {tolerance:g}")
    if kind not in GCODE:
        raise click.UsageError("--tolerance is for G-code")
    if not firmware_of(played_by(profile, firmware or profile.firmware.dialect)).decimates:
        raise click.UsageError("--tolerance is for Klipper")


# ----------------------------------------- what slicers tell in variables SLIC3R_*


def slicer_warnings(environ: Mapping[str, str], limits: Limits) -> list[str]:
    """Return a warning if the slicer's accelerations exceed the profile's."""
    excessive = {
        name: value for name, value in _accelerations(environ).items()
        if value > limits.acceleration
    }  # fmt: skip
    if not excessive:
        return []
    settings = ", ".join(f"{name} {value:g}" for name, value in sorted(excessive.items()))
    return [
        f"SLICER           asks for more acceleration than the profile's "
        f"{limits.acceleration:g} mm/s² ({settings}): the profile's is used"
    ]


def _accelerations(environ: Mapping[str, str]) -> dict[str, float]:
    """Return mm/s² by setting; without zeros, which leave the choice to the firmware."""
    found = {}
    for variable, text in environ.items():
        name = variable.removeprefix("SLIC3R_")
        machine_limit = name.startswith("MACHINE_")
        if name == variable or machine_limit or not name.endswith("_ACCELERATION"):
            continue
        values = [number(part) for part in text.split(",")]  # one per extruder, or percentages
        usable = [value for value in values if 0.0 < value < math.inf]
        if usable:
            found[name.lower()] = max(usable)
    return found
