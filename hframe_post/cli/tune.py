"""``hframe-post tune``: recommend a profile's window, weight and acceleration."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import click

from hframe_post import library, plotting
from hframe_post.cli.json_summary import json_option, open_json
from hframe_post.cli.model_output import ModelOutput
from hframe_post.cli.options import (
    files_read,
    number,
    opened,
    print_options,
    seed_option,
    share,
    shown_working,
)
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import parsed
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.errors import HframeError
from hframe_post.firmware.registry import firmware
from hframe_post.gcode.lines import Input
from hframe_post.model.plant import Plant
from hframe_post.prediction.best_shaper import error
from hframe_post.printer.model_file import with_windows
from hframe_post.printer.schema import LARGEST
from hframe_post.printer.settings import Printer
from hframe_post.studies.inputs import rectangle
from hframe_post.studies.shapers.search import (
    calibrated,
    search,
    shapings_as_json,
    shapings_as_text,
)
from hframe_post.studies.simulation.uncertainty import draws as random_plants
from hframe_post.studies.tuning import pareto
from hframe_post.studies.tuning.report import (
    pace_as_json,
    pace_table,
    stops_table,
    summary,
    trade_off,
    trials_table,
)
from hframe_post.studies.tuning.tune import EFFORTS, KNOTS
from hframe_post.writers.files import Outputs


def weight(text: str) -> float:
    value = number(text)
    if not 0.0 <= value < LARGEST:
        raise click.BadParameter(f"{text!r} is not a number from 0 to below {LARGEST:g}")
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
@click.option(
    "--figure", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE",
    help="Draw error against motor effort, and against print time (.png or .svg). Needs "
    "matplotlib.",
)  # fmt: skip
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="PROFILE.TOML",
    help="Write a profile with the recommended values; may be the one given with -p.",
)  # fmt: skip
@click.option("--keep-limits", is_flag=True, help="Do not recommend other limits of the path.")
@click.option(
    "--shaper", is_flag=True,
    help="Instead, recommend input shapers (Klipper's [input_shaper], Marlin's M593), to print "
    "files without converting them.",
)  # fmt: skip
@json_option
def tune(
    source: Path | None, printer: str, options: Options, knots: tuple[int, ...],
    effort: tuple[float, ...], model_error: float | None, draws: int, seed: int,
    figure: Path | None, output: Path | None, keep_limits: bool, shaper: bool,
    json_file: Path | None,
) -> None:  # fmt: skip
    """Try windows and weights on a print, and recommend the best that the motors can follow.

    More weight (λ) spares the motors and leaves more error; closer knots (small L) can cancel
    faster ringing. Of the settings with an error within a tenth of the smallest, the gentlest is
    recommended. Acceleration, deceleration and jerk are then chosen on half a minute of the print:
    lower ones, as long as they halve the error for a tenth more time. Without a file, the paper's
    rectangle of 120 x 20 mm is used. The last table shows the time of each compensation.stops.

    \b
    Example:
      hframe-post tune in.gcode -p my.toml -o my.toml
    """
    profile = library.load_printer(printer)
    draws = 0 if model_error is None and library.is_doubtful(profile) else draws
    model_error = library.model_uncertainty(profile) if model_error is None else model_error
    reads = files_read(source, printer)
    if shaper:
        if figure is not None or output is not None:
            raise click.UsageError("--shaper writes neither --figure nor --output")
        with opened(source, profile, quiet=False) as lines, Outputs(reads) as outputs:
            _recommend_shaper(lines, profile, options, open_json(outputs, json_file), json_file)
        return
    _check_figure(figure)
    # The profile is written last: only if there is a recommendation, and after the findings.
    with Outputs(reads) as recommendation:
        file = ModelOutput(recommendation, output, printer) if output is not None else None
        with Outputs([*reads, *([output] if output else [])]) as findings:
            write_json = open_json(findings, json_file)
            drawing = findings.open(figure) if figure is not None else None
            with opened(source, profile, quiet=True) as lines, shown_working():
                tuned = library.tune(
                    lines, profile, options, knots=knots or KNOTS, efforts=effort or EFFORTS,
                    model_error=model_error, draws=draws, seed=seed,
                )  # fmt: skip
            best, pace = tuned.best, None
            if not (keep_limits or str(source) == "-"):  # which cannot be read again
                plants = random_plants(profile.plant, model_error, draws, seed)
                pace = _pace(source or rectangle(profile), profile, tuned, plants)
            found = summary(tuned.trials, best, model_error, draws, tuned.stops)
            failure = None
            if best is None:
                failure = HframeError(
                    "no candidate stays within the motors' limits: try a larger --effort, or a "
                    "slower print"
                )
            write_json(found | (pace_as_json(pace) if pace else {}), error=failure)
            if figure is not None and drawing is not None:
                drawn = trade_off(tuned.trials, best, profile.motors, pace)
                plotting.save(drawn, drawing, figure.suffix.removeprefix("."))
        click.echo(_tables(profile, tuned, pace), err=str(json_file) == "-")
        if failure is not None:
            raise failure
        if file is not None and best is not None:
            windows = best.windows
            if pace is not None and pace.chosen is not None:
                windows = pace.chosen.trial.windows
                lower = (f"{key} = {value}" for key, value in pace.chosen.settings.items())
                click.echo(f"Next: below [limits] of {output} write {', '.join(lower)}", err=True)
            file.write(with_windows(profile, windows))


def _check_figure(figure: Path | None) -> None:
    """Raise, before any work, if the figure cannot be drawn."""
    if figure is not None:
        if figure.suffix not in (".png", ".svg"):
            raise click.UsageError("--figure must end in .png or .svg")
        plotting.canvas(1, 1, (1.0, 1.0))


def _pace(
    source: Path | Iterable[bytes], profile: Printer, tuned: library.Tuning, plants: list[Plant]
) -> pareto.Pareto | None:
    """Return the search for limits of the path; None without a window or a motion to try them."""
    if tuned.best is None or not (kept := pareto.pieces(Input(source).again(), profile)):
        return None
    grid = pareto.windows(tuned.trials, tuned.best, profile.motors)
    return pareto.pareto(kept, profile, grid, plants)


def _tables(profile: Printer, tuned: library.Tuning, pace: pareto.Pareto | None) -> str:
    paced = pace_table(pace) if pace else ""
    advice = "best with the profile's limits" if paced else "recommended"
    table = trials_table(tuned.trials, tuned.best, advice) + paced
    if tuned.stops:
        table += f"\n\n{stops_table(tuned.stops, profile.compensation.stops)}"
    return table


def _recommend_shaper(
    lines: Iterable[bytes], profile: Printer, options: Options,
    write_json: Callable[[dict[str, Any]], None], json_file: Path | None,
) -> None:  # fmt: skip
    pieces = SlicedFile.from_items(parsed(lines, profile, options), profile).paths
    found = search(profile.plant, pieces)
    usual = error(profile.plant, calibrated(profile.plant), pieces)
    write_json(shapings_as_json(found, usual))
    click.echo(shapings_as_text(found, usual, firmware(profile)), err=str(json_file) == "-")
