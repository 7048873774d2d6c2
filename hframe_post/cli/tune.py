"""``hframe-post tune``: which λ and L for this printer and this kind of print."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hframe_post.cli.options import (
    check_figure,
    figure_option,
    files_read,
    json_option,
    open_json,
    opened,
    print_options,
    seed_option,
    share,
    weight,
)

if TYPE_CHECKING:
    from hframe_post.gcode.options import Extrusion, FileLimits, ReadOptions
    from hframe_post.printer.settings import Printer

NO_CANDIDATE = (
    "no candidate stays within the motors' limits: try larger --effort, or a slower print"
)


@click.command()
@print_options
@click.option(
    "--knots", "-L", type=click.IntRange(2, 200), multiple=True, metavar="L",
    help="Samples between knots to try; may be repeated. Default: 5, 8, 10, 20.",
)  # fmt: skip
@click.option(
    "--effort", type=weight, multiple=True, metavar="λ",
    help="Weights of x to try; may be repeated. Default: 0.1 to 1000.",
)  # fmt: skip
@click.option(
    "--model-error", default="5%", show_default=True, type=share, metavar="PERCENT",
    help="Printers drawn around the model, on which the recommendation must be good too.",
)  # fmt: skip
@click.option("--draws", type=click.IntRange(0, 1000), default=10, show_default=True,
              help="How many printers to draw; 0 for the model alone.")  # fmt: skip
@seed_option
@figure_option("the trade-off")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="PROFILE.TOML",
    help="Write a profile with the recommended values; may be the one given with -p.",
)  # fmt: skip
@click.option(
    "--shaper", is_flag=True,
    help="Instead, for those who want no dense stream: the [input_shaper] section for Klipper's "
    "printer.cfg that serves this printer and print best.",
)  # fmt: skip
@json_option
def tune(
    source: Path | None, path: str | None, printer: str, limits: FileLimits,
    extrusion: Extrusion | None, knots: tuple[int, ...], effort: tuple[float, ...],
    model_error: float, draws: int, seed: int, figure: Path | None, output: Path | None,
    shaper: bool, json_file: Path | None,
) -> None:  # fmt: skip
    """Try windows and weights on a print, and recommend the best the motors can follow.

    More weight (λ) drives the motors less hard and leaves more error; finer knots (small L)
    can cancel faster ringing. Recommended is the gentlest of those whose error, under model
    error, is within a tenth of the best. The settings of compensation.stops are shown with
    the print time that each takes.

    \b
    Example:
      hframe-post tune in.gcode -p my.toml -o my.toml
    """
    from hframe_post import library, plotting
    from hframe_post.errors import HframeError
    from hframe_post.gcode.options import ReadOptions
    from hframe_post.printer.edit import with_windows
    from hframe_post.studies.plots import trade_off
    from hframe_post.studies.tuning import EFFORTS, KNOTS
    from hframe_post.studies.tuning_report import stops_table, summary, trials_table
    from hframe_post.writers.atomic_file import Outputs

    profile = library.load_printer(printer)
    reads = files_read(source, printer)
    if shaper:
        if figure is not None or output is not None:
            raise click.UsageError("--shaper writes neither figure nor profile")
        reading = ReadOptions.of(profile, limits, extrusion)
        with opened(source, path, profile, quiet=False) as lines, Outputs(reads) as findings:
            _tell_shaper(lines, profile, reading, open_json(findings, json_file), json_file)
        return
    check_figure(figure)
    with Outputs(reads) as recommendation:
        file = recommendation.open(output, Path(printer)) if output is not None else None
        with (
            opened(source, path, profile, quiet=False) as lines,
            Outputs([*reads, *([output] if output else [])]) as findings,
        ):
            write_json = open_json(findings, json_file)
            drawing = findings.open(figure) if figure is not None else None
            tuned = library.tune(
                lines, profile, knots=knots or KNOTS, efforts=effort or EFFORTS,
                model_error=model_error, draws=draws, seed=seed, limits=limits, extrusion=extrusion,
            )  # fmt: skip
            trials, best = tuned.trials, tuned.best
            write_json(summary(trials, best, model_error, draws, tuned.stops))
            if figure is not None and drawing is not None:
                kind = figure.suffix.removeprefix(".")
                plotting.save(trade_off(trials, best, profile.motors), drawing, kind)
        click.echo(trials_table(trials, best), err=str(json_file) == "-")
        if tuned.stops:
            told = stops_table(tuned.stops, profile.compensation.stops)
            click.echo(f"\n{told}", err=str(json_file) == "-")
        if best is None:
            raise HframeError(NO_CANDIDATE)
        if file is not None:
            file.write(with_windows(printer, best.windows).encode())


def _tell_shaper(
    lines: Iterable[bytes], profile: Printer, reading: ReadOptions,
    write_json: Callable[[dict[str, Any]], None], json_file: Path | None,
) -> None:  # fmt: skip
    """The best input shaper there is, and what leaving it to Klipper would give."""
    from hframe_post.studies.shaping import calibrated, error, excerpt, search
    from hframe_post.studies.shaping_report import shapings_as_json, shapings_as_text

    path, counted = excerpt(lines, profile, reading)
    found = search(profile.plant, path, counted)
    usual = error(profile.plant, calibrated(profile.plant), path, counted)
    write_json(shapings_as_json(found, usual))
    click.echo(shapings_as_text(found, usual), err=str(json_file) == "-")
