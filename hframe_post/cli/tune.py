"""``hframe-post tune``: recommend a profile's window and weight."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import click

from hframe_post import library
from hframe_post.cli.json_summary import json_option, open_json
from hframe_post.cli.model_output import ModelOutput
from hframe_post.cli.options import (
    files_read,
    number,
    old_option,
    opened,
    print_options,
    seed_option,
    share,
    shown_working,
)
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.errors import HframeError
from hframe_post.firmware.registry import firmware
from hframe_post.prediction.best_shaper import error
from hframe_post.printer.model_file import with_windows
from hframe_post.printer.schema import MAX_NUMBER
from hframe_post.printer.settings import Printer
from hframe_post.studies.shapers.search import (
    calibrated,
    search,
    shapings_as_json,
    shapings_as_text,
)
from hframe_post.studies.tuning.report import (
    stops_table,
    summary,
    trials_table,
)
from hframe_post.studies.tuning.tune import EFFORTS, KNOTS
from hframe_post.writers.outputs import Outputs


def weight(text: str) -> float:
    value = number(text)
    if not 0.0 <= value < MAX_NUMBER:
        raise click.BadParameter(f"{text!r} is not a number from 0 to below {MAX_NUMBER:g}")
    return value


@click.command()
@print_options("limits", "extrusion")
@click.option(
    "--knots", "-L", type=click.IntRange(2, 200), multiple=True, metavar="L",
    help="Samples between knots to try; may be repeated. Default: 5, 8, 10, 20.",
)  # fmt: skip
@click.option(
    "--effort", type=weight, multiple=True, metavar="λ",
    help="Weights of x to try; may be repeated. Default: 0.1 to 1000.",
)  # fmt: skip
@click.option(
    "--model-error", type=share, metavar="PERCENT",
    help="How much the printer may differ from its model: the recommendation must also be good for "
    "random printers within it. Default: plant.uncertainty of the profile, or 5%.",
)  # fmt: skip
@click.option(
    "--draws", type=click.IntRange(0, 1000), default=10, show_default=True,
    help="Number of random printers; 0 for the model alone.",
)  # fmt: skip
@seed_option
@old_option("--figure", "--json has the numbers")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="PROFILE.TOML",
    help="Write a profile with the recommended values; may be the one given with -p.",
)  # fmt: skip
@old_option("--keep-limits", "tune recommends no other limits of the path", flag=True)
@click.option(
    "--shaper", is_flag=True,
    help="Instead, recommend input shapers (Klipper's [input_shaper], Marlin's M593), to print "
    "files without converting them.",
)  # fmt: skip
@json_option
def tune(
    source: Path | None, printer: str, options: Options, knots: tuple[int, ...],
    effort: tuple[float, ...], model_error: float | None, draws: int, seed: int,
    output: Path | None, shaper: bool, json_file: Path | None,
) -> None:  # fmt: skip
    """Try windows and weights on a print, and recommend the best that the motors can follow.

    More weight (λ) spares the motors and leaves more error; closer knots (small L) can cancel
    faster ringing. Of the settings with an error within a tenth of the smallest, the gentlest is
    recommended. Without a file, the paper's rectangle of 120 x 20 mm is used. The last table shows
    the time of each compensation.stops.

    \b
    Example:
      hframe-post tune in.gcode -p my.toml -o my.toml
    """
    profile = library.load_printer(printer)
    draws = 0 if model_error is None and library.is_doubtful(profile) else draws
    model_error = library.model_uncertainty(profile) if model_error is None else model_error
    reads = files_read(source, printer)
    if shaper:
        if output is not None:
            raise click.UsageError("--shaper writes no --output")
        with opened(source, profile, quiet=False) as lines, Outputs(reads) as outputs:
            _recommend_shaper(lines, profile, options, open_json(outputs, json_file), json_file)
        return
    # The profile is written last: only if there is a recommendation, and after the findings.
    with Outputs(reads) as recommendation:
        file = ModelOutput(recommendation, output, printer) if output is not None else None
        with Outputs([*reads, *([output] if output else [])]) as findings:
            write_json = open_json(findings, json_file)
            with opened(source, profile, quiet=True) as lines, shown_working():
                tuned = library.tune(
                    lines, profile, options, knots=knots or KNOTS, efforts=effort or EFFORTS,
                    model_error=model_error, draws=draws, seed=seed,
                )  # fmt: skip
            best = tuned.best
            found = summary(tuned.trials, best, model_error, draws, tuned.stops)
            failure = None
            if best is None:
                failure = HframeError(
                    "no candidate stays within the motors' limits: try a larger --effort, or a "
                    "slower print"
                )
            write_json(found, error=failure)
        click.echo(_tables(profile, tuned), err=str(json_file) == "-")
        if failure is not None:
            raise failure
        if file is not None and best is not None:
            file.write(with_windows(profile, best.windows))


def _tables(profile: Printer, tuned: library.Tuning) -> str:
    table = trials_table(tuned.trials, tuned.best)
    if tuned.stops:
        table += f"\n\n{stops_table(tuned.stops, profile.compensation.stops)}"
    return table


def _recommend_shaper(
    lines: Iterable[bytes], profile: Printer, options: Options,
    write_json: Callable[[dict[str, Any]], None], json_file: Path | None,
) -> None:  # fmt: skip
    pieces = SlicedFile.from_items(Chain(profile, options).parsed(lines), profile).paths
    found = search(profile.plant, pieces)
    usual = error(profile.plant, calibrated(profile.plant), pieces)
    write_json(shapings_as_json(found, usual))
    click.echo(shapings_as_text(found, usual, firmware(profile)), err=str(json_file) == "-")
