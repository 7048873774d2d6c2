"""``hframe-post convert`` and ``simulate``: a sliced file, rewritten or predicted."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import click

from hframe_post import library
from hframe_post.cli.parameters import (
    STREAMED,
    Summary,
    chosen_printer,
    dashed,
    files_read,
    progress_bar,
    say,
    share,
    shared,
)
from hframe_post.conversion.options import Options
from hframe_post.errors import LeftAloneError, one_line
from hframe_post.firmware.registry import firmware
from hframe_post.gcode.lines import Input, lines_of
from hframe_post.printer.choice import verification_as_text
from hframe_post.process import keep_memory
from hframe_post.writers.outputs import Outputs

# in PrusaSlicer and OrcaSlicer: the slicer's name for the file, which is a temporary one by now
OUTPUT_NAME = "SLIC3R_PP_OUTPUT_NAME"


@click.command()
@click.argument("source", metavar="IN.GCODE", type=click.Path(path_type=Path, allow_dash=True))
@click.argument("more", nargs=-1, metavar="")
@click.option("-o", "--output", type=STREAMED, help="Output file. Default: replace the input.")
@shared(
    "format", "printer", "strategy", "firmware", "limits", "extrusion", "clamp", "force",
    "tolerance", "predict", "max_error", "jobs", "json",
)  # fmt: skip
@click.option(
    "--report", "report_file", metavar="FILE", type=STREAMED,
    help="Report for a browser (.html), or a text.",
)  # fmt: skip
@click.option("-n", "--dry-run", is_flag=True, help="Print the summary, but write no G-code.")
@shared("help_all", "quiet")
def convert(
    source: Path, more: tuple[str, ...], output: Path | None, printer: str,
    options: Options, summary: Summary, report_file: Path | None, dry_run: bool, quiet: bool,
) -> None:  # fmt: skip
    """Convert a sliced file. '-' is standard input, or output.

    A file that was converted with the same settings, or has a line '; hframe-post: off', is left as
    it is. Exit status: 0 for success, 1 for an error (nothing is written then), 2 for wrong usage.

    \b
    Examples:
      hframe-post in.gcode -o out.gcode -p my.toml
      hframe-post in.gcode --report report.html
    """
    to_stdout = str(output) == "-" or (output is None and str(source) == "-")
    html = report_file if report_file and report_file.suffix == ".html" else None
    _check_usage(more, [to_stdout, summary.to_stdout, str(report_file) == "-"])
    profile, choice = library.load_printer(printer), chosen_printer()
    name_in_slicer = os.environ.get(OUTPUT_NAME)
    # the paper's printer may be shown, but not in place: so do slicers what they print
    if choice.demonstrates and output is not None and name_in_slicer is None:
        options = replace(options, force=True)
    head = [f"file             {one_line(name_in_slicer)}"] if name_in_slicer else []
    head += [choice.as_text(), *verification_as_text(profile)]
    target = None if dry_run else "-" if to_stdout else output or source
    keep_memory()
    with (
        _leaving_alone(source, None if dry_run else output, summary, html is not None, quiet),
        Outputs(files_read(source, printer)) as outputs,
        progress_bar(source, quiet) as advance,
    ):
        summary.open(outputs)
        text_file = outputs.open(dashed(report_file)) if report_file and not html else None
        report = library.convert(
            dashed(source) or sys.stdin.buffer, target, profile, options, page=html, notes=head,
            title=one_line(Path(name_in_slicer or source).name), outputs=outputs, progress=advance,
        )  # fmt: skip
        report = replace(report, notices=(*cut_off(source), *report.notices))
        summary.write({**choice.as_json(), **report.as_json()})
        text = report.summary(head)
        if text_file is not None:
            text_file.write(text.encode() + b"\n")
    if not quiet:
        say(text)


def cut_off(source: Path) -> list[str]:
    """Return a warning if a file ends in the middle of a move, as an upload does that stopped."""
    if not source.is_file():
        return []
    with source.open("rb") as file:
        file.seek(max(source.stat().st_size - 200, 0))  # no slicer writes longer lines
        last = file.read().rpartition(b"\n")[2].lstrip()
    if last[:2].upper() not in (b"G0", b"G1", b"G2", b"G3"):
        return []
    return ["the last line has no end, so the file may be cut off: compare it with the slicer's"]


def _check_usage(more: tuple[str, ...], to_stdout: list[bool]) -> None:
    if more:
        raise click.UsageError(
            f"one file at a time: for another output use -o {more[0]}, for many files "
            "'hframe-post batch'"
        )
    if to_stdout.count(True) > 1:
        raise click.UsageError("only one of output, JSON and report can go to standard output")


@contextmanager
def _leaving_alone(
    source: Path, output: Path | None, summary: Summary, html: bool, quiet: bool
) -> Iterator[None]:
    """Copy a file that is not to be converted to the output, say so, and end the command."""
    try:
        yield
    except LeftAloneError as found:
        if html or not source.is_file():
            raise
        with Outputs([source]) as outputs, source.open("rb") as file:
            summary.open(outputs)
            summary.write({"left_alone": str(found)})
            if output is not None and not (output.exists() and output.samefile(source)):
                shutil.copyfileobj(file, outputs.open(dashed(output), source))
        if not quiet:
            say(f"{source}: {found.cause}; left as it is")
        raise click.exceptions.Exit(0) from None


# ---------------------------------------------------------------------- simulate


@click.command()
@click.argument(
    "source", metavar="[IN.GCODE]", required=False,
    type=click.Path(path_type=Path, allow_dash=True),
)  # fmt: skip
@shared("printer", "limits", "extrusion", "clamp", "help_all")
@click.option(
    "--plant", "plant_file", metavar="NAME|FILE",
    help="Judge on the model of this profile.", hidden=True,
)  # fmt: skip
@click.option(
    "--model-error", "shares", type=share, multiple=True, metavar="PERCENT",
    help="Also judge on random printers that differ from the model by up to this. May be repeated.",
)  # fmt: skip
@click.option(
    "--draws", type=click.IntRange(1, 1000), default=50, show_default=True,
    help="Random printers for each --model-error.", hidden=True,
)  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Random seed.", hidden=True
)
@click.option("--steps", is_flag=True, help="Round the motors' motion to whole steps.", hidden=True)
@click.option(
    "--shapers", is_flag=True,
    help="Compare with input shapers at their best, and print settings.",
)  # fmt: skip
@shared("json", "report", "quiet")
def simulate(
    source: Path | None, printer: str, options: Options, plant_file: str | None,
    shares: tuple[float, ...], draws: int, seed: int, steps: bool, shapers: bool,
    summary: Summary, report_file: Path | None, quiet: bool,
) -> None:  # fmt: skip
    """Predict the error of a print without compensation, with fbs, and with racking compensation.

    The contour error is the distance of the nozzle from the slicer's path; the tracking error is
    its distance from where it should be at that time. Without a file, a rectangle is simulated.

    \b
    Example:
      hframe-post simulate in.gcode -p my.toml --model-error 5%
    """
    from hframe_post.studies.shaping import compare_shapers, comparison_as_json, comparison_as_text
    from hframe_post.studies.tuning import rectangle

    profile = library.load_printer(printer)
    simulated = library.load_printer(plant_file) if plant_file else profile
    with (
        progress_bar(source, quiet) as advance,
        Outputs(files_read(source, printer, plant_file)) as outputs,
    ):
        summary.open(outputs)
        printed = rectangle(profile) if source is None else dashed(source)
        if printed is None:
            printed = list(lines_of(sys.stdin.buffer))  # it is read several times
        head = [(choice := chosen_printer()).as_text()]
        report = library.simulate(
            printed, profile, options, simulated=simulated, progress=advance,
            model_error=shares, draws=draws, seed=seed, steps=steps,
            page=report_file, title=source.name if source else "rectangle", notes=head,
            outputs=outputs,
        )  # fmt: skip
        text = "\n".join([*head, report.as_text()])
        found = {**choice.as_json(), **report.as_json()}
        if shapers:
            ours = replace(options, strategy="racking", clamp=True)
            compared = compare_shapers(Input(printed).again, profile, ours, simulated.plant)
            text += "\n" + comparison_as_text(compared, firmware(profile))
            found["against"] = comparison_as_json(compared)
        summary.write(found)
    if not quiet:
        click.echo(text, err=summary.to_stdout)
