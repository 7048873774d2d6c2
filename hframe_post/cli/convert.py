"""``hframe-post convert``: from file to file."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hframe_post.cli.options import (
    FirmwareChoice,
    LazyChoice,
    chosen_printer,
    dashed,
    extrusion_option,
    files_read,
    force_option,
    formats,
    json_option,
    limits_option,
    on_limit_option,
    open_json,
    printer_option,
    say,
    strategies,
)
from hframe_post.cli.progress import progress
from hframe_post.cli.speed import asked, speed_options, told, told_as_json
from hframe_post.cli.verbose import log, log_stages, verbose_option

if TYPE_CHECKING:
    from hframe_post.conversion.pipeline import Options, Retract
    from hframe_post.gcode.options import Extrusion, LimitSource
    from hframe_post.printer.settings import Printer


@click.command()
@click.argument("source", metavar="IN.GCODE", type=click.Path(path_type=Path, allow_dash=True))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, allow_dash=True, dir_okay=False),
    help="Output file; '-' for standard output. Without it the input is replaced.",
)  # fmt: skip
@click.option(
    "--format", "asked_format", type=LazyChoice(formats),
    help="G-code (of Prusa's binary form: bgcode), steps of the motors (a row each, or a row a "
    "tick), or samples every millisecond. Default: steps for .csv, samples for .npz and .parquet, "
    "bgcode for .bgcode or a binary file in place, else gcode.",
)  # fmt: skip
@printer_option
@click.option(
    "-c", "--compensation", type=LazyChoice(strategies),
    help="Racking and ringing, ringing only (fbs), or none. Default: the profile's.",
)  # fmt: skip
@click.option(
    "--firmware", type=FirmwareChoice(),
    help="G-code: who reads the output. Default: the profile's.",
)  # fmt: skip
@limits_option
@extrusion_option
@on_limit_option
@force_option
@click.option(
    "--tolerance", type=click.FloatRange(1e-4, 0.1), show_default="0.014", metavar="MM",
    help="G-code for Klipper: how far the written command may be off the computed one.",
)  # fmt: skip
@click.option(
    "--every-sample", is_flag=True, help="G-code for Klipper: write a line for every millisecond."
)
@click.option(
    "--retract", type=click.Choice(["standing", "moving"]), default="standing", show_default=True,
    help="For Klipper: where to retract, before the travel as the file has it, or on it where "
    "there is time, without stopping.",
)  # fmt: skip
@click.option(
    "--predict", type=click.Choice(["chosen", "all", "off"]), default="chosen", show_default=True,
    help="Contour error to predict: of no compensation and the chosen one, of all, of none.",
)  # fmt: skip
@speed_options
@click.option(
    "--jobs", type=click.IntRange(1), metavar="N",
    help="G-code: processes that compute it; the output is the same. Default: as many as there "
    "are processors.",
)  # fmt: skip
@json_option
@click.option(
    "--report", "report_file", metavar="FILE",
    type=click.Path(path_type=Path, allow_dash=True, dir_okay=False),
    help="Write the summary as text, where a slicer does not show it; '-' for standard output. "
    "With a name that ends in .html: a page with a view of the layers.",
)  # fmt: skip
@click.option("-n", "--dry-run", is_flag=True, help="Report, but write nothing.")
@verbose_option
@click.option("-q", "--quiet", is_flag=True, help="No summary, no progress bar.")
def convert(
    source: Path, output: Path | None, asked_format: str | None, printer: str,
    firmware: str | None, compensation: str | None, limits: LimitSource,
    extrusion: Extrusion | None, on_limit: str, force: bool, tolerance: float | None,
    every_sample: bool, retract: Retract, predict: str, max_error: dict[str, float] | None,
    error_measure: str | None, speed_up: float | None, model_error: float | None,
    jobs: int | None, json_file: Path | None, report_file: Path | None, dry_run: bool, quiet: bool,
) -> None:  # fmt: skip
    """Convert a sliced file. '-' reads standard input.

    The nozzle's motion is predicted with the printer's model, and the commands are changed
    so that the nozzle, not the motors, follows the slicer's path. Exit status 0 is success, 1
    an error in the input or the profile (nothing is written then), 2 wrong usage.

    \b
    Examples:
      hframe-post in.gcode -o out.gcode -p my.toml
      hframe-post in.gcode --report report.html
    """
    from hframe_post.cli import slicer
    from hframe_post.conversion.files import Target
    from hframe_post.conversion.files import convert as converted
    from hframe_post.conversion.pipeline import TOLERANCE
    from hframe_post.printer.choice import proof
    from hframe_post.process import processor_count
    from hframe_post.writers.files.atomic_file import Outputs

    to_stdout = str(output) == "-" or (output is None and str(source) == "-")
    html = report_file is not None and report_file.suffix == ".html"
    _check_streams(to_stdout, json_file, report_file, source, html)
    kind = _kind(source, output, to_stdout, asked_format, dry_run)
    finely = tolerance is not None or every_sample
    profile = _profile(printer, firmware, kind, finely)
    fast = asked(profile, source, max_error, error_measure, speed_up, model_error)
    profile = replace(profile, invented=profile.invented and not force)
    options = _options(profile, kind, compensation, predict, limits, extrusion, on_limit,
                       None if every_sample else tolerance or TOLERANCE)  # fmt: skip
    options = replace(options, retract=retract, speed=fast)
    log(f"profile {printer}, {profile.firmware.dialect}, strategy {options.strategy}")
    found = None
    if fast is not None:
        from hframe_post.gcode.lines import reread
        from hframe_post.studies.speed.search import hastened

        found = hastened(reread(source), profile, options)
        profile, options = found.printer, found.options
        log("the quickest print within the error is found")
    with (
        click.open_file(str(source), "rb") as file,
        Outputs(files_read(source, printer)) as outputs,
        progress(file, source, quiet) as lines,
    ):
        write_json = open_json(outputs, json_file)
        summary = outputs.open(dashed(report_file)) if report_file is not None else None
        if str(source) != "-":
            outputs.watch(file, source)
        target = Target(outputs, None if to_stdout else output or source, source)
        jobs = jobs or processor_count()
        log(f"conversion to {kind}, --jobs {jobs}")
        report = converted(lines, None if dry_run else target, profile, options, kind, jobs)
        log(f"{report.read.lines} lines are converted")
        log_stages(report.seconds)
        write_json({**chosen_printer().as_json(), **report.as_json(), **told_as_json(found)})
        text = "\n".join(
            [
                *slicer.output(os.environ),
                chosen_printer().as_text(),
                proof(profile),
                report.as_text(),
                *told(found),
                *slicer.warnings(os.environ, profile.limits),
            ]
        )
        if summary is not None and html:
            from hframe_post.page.build import page

            log("page: simulation of all strategies")
            file.seek(0)
            name = slicer.shown_name(os.environ, source)
            summary.write(page(file, profile, options, name, text.splitlines()))
        elif summary is not None:
            summary.write(text.encode() + b"\n")
    log("all files are written")
    if not quiet:
        say(text)


def _check_streams(
    to_stdout: bool, json_file: Path | None, report_file: Path | None, source: Path, html: bool
) -> None:
    if [to_stdout, str(json_file) == "-", str(report_file) == "-"].count(True) > 1:
        raise click.UsageError("only one of output, JSON and report can go to standard output")
    if html and str(source) == "-":
        raise click.UsageError("a page needs a file to read twice, not standard input")


def _kind(
    source: Path, output: Path | None, to_stdout: bool, asked: str | None, dry_run: bool
) -> str:
    """The format of the output. Raises UsageError where it cannot go there."""
    from hframe_post.conversion.files import GCODE, chosen_format
    from hframe_post.errors import HframeError

    try:
        kind = chosen_format(
            None if to_stdout else output, asked, source if output is None else None
        )
    except HframeError as error:
        raise click.UsageError(str(error)) from None
    if kind not in GCODE and output is None and not (to_stdout or dry_run):
        raise click.UsageError(f"{kind} would replace the G-code: name a file with -o")
    return kind


def _profile(printer: str, firmware: str | None, kind: str, finely: bool) -> Printer:
    """The printer as that firmware plays it. finely: whether it is told how finely to write."""
    from hframe_post.conversion.files import GCODE
    from hframe_post.firmware.registry import firmware as chosen
    from hframe_post.printer.profile import load, played_by

    if finely and kind not in GCODE:
        raise click.UsageError("--tolerance and --every-sample are for G-code")
    profile = load(printer)
    profile = played_by(profile, firmware or profile.firmware.dialect)
    if finely and not chosen(profile).decimates:
        raise click.UsageError("--tolerance and --every-sample are for Klipper")
    return profile


def _options(
    profile: Printer, kind: str, compensation: str | None, predict: str, limits: LimitSource,
    extrusion: Extrusion | None, on_limit: str, tolerance: float | None,
) -> Options:  # fmt: skip
    from hframe_post.conversion.files import GCODE
    from hframe_post.conversion.pipeline import Options
    from hframe_post.model.strategies import STRATEGIES

    strategy = compensation or profile.compensation.strategy
    wanted = {"chosen": ("none", strategy), "all": tuple(STRATEGIES), "off": ()}[predict]
    return Options(
        strategy,
        tuple(dict.fromkeys(wanted)),
        limits=limits,
        extrusion=extrusion,
        clamp=on_limit == "clamp",
        tolerance=tolerance if kind in GCODE else None,
    )
