"""``hframe-post simulate``: predict what compensation does for a print."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import click

from hframe_post import library
from hframe_post.cli.parameters import (
    Summary,
    chosen_printer,
    conversion_options,
    dashed,
    files_read,
    help_all_option,
    json_option,
    page_option,
    printer_option,
    progress_bar,
    share,
)
from hframe_post.conversion.options import Options
from hframe_post.firmware.registry import firmware
from hframe_post.gcode.lines import Input, lines_of
from hframe_post.studies.shaping import (
    compare_shapers,
    comparison_as_json,
    comparison_as_text,
)
from hframe_post.studies.tuning import rectangle
from hframe_post.writers.outputs import Outputs


@click.command()
@click.argument(
    "source", metavar="[IN.GCODE]", required=False,
    type=click.Path(path_type=Path, allow_dash=True),
)  # fmt: skip
@printer_option
@conversion_options("limits", "extrusion", "clamp")
@help_all_option
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
@json_option
@page_option
@click.option("-q", "--quiet", is_flag=True, help="Print no summary and no progress bar.")
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
