"""``hframe-post tune``: which λ and L for this printer and this kind of print."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hframe_post.cli.options import (
    json_option,
    limits_option,
    opened,
    path_option,
    printer_option,
    seed_option,
    share,
    source_argument,
    weight,
    write_json,
)
from hframe_post.studies.tuning_report import trial_as_json, trials_table

if TYPE_CHECKING:
    from hframe_post.printer.settings import Printer


@click.command()
@source_argument
@path_option
@printer_option
@limits_option
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
@click.option(
    "--figure", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE",
    help="Draw the trade-off (.png or .svg); needs matplotlib.",
)  # fmt: skip
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
    source: Path | None, path: str | None, printer: str, limits: str, knots: tuple[int, ...],
    effort: tuple[float, ...], model_error: float, draws: int, seed: int, figure: Path | None,
    output: Path | None, shaper: bool, json_file: Path | None,
) -> None:  # fmt: skip
    """Try windows and weights on a print, and recommend the best the motors can follow.

    More weight (λ) drives the motors less hard and leaves more error; finer knots (small L)
    can cancel faster ringing. Recommended is the gentlest of those whose error, under model
    error, is within a tenth of the best.
    """
    from hframe_post import library, plotting
    from hframe_post.errors import HframeError
    from hframe_post.printer.edit import with_windows
    from hframe_post.studies.plots import trade_off
    from hframe_post.studies.tuning import EFFORTS, KNOTS
    from hframe_post.writers.atomic_file import OutputFile

    profile = library.load_printer(printer)
    if shaper:
        if figure is not None or output is not None:
            raise click.UsageError("--shaper writes neither figure nor profile")
        with opened(source, path, profile, quiet=False) as lines:
            _shaper(lines, profile, limits == "file", json_file)
        return
    if figure is not None:
        if figure.suffix not in (".png", ".svg"):
            raise click.UsageError("--figure must end in .png or .svg")
        plotting.canvas(1, 1, (1.0, 1.0))  # say at once that matplotlib is missing
    with opened(source, path, profile, quiet=False) as lines:
        tuned = library.tune(
            lines, profile, knots=knots or KNOTS, efforts=effort or EFFORTS,
            model_error=model_error, draws=draws, seed=seed, file_limits=limits == "file",
        )  # fmt: skip
    trials, best = tuned.trials, tuned.best
    summary: dict[str, Any] = {
        "model_error": model_error if draws else 0.0,
        "draws": draws,
        "trials": [trial_as_json(trial) for trial in trials],
        "recommended": trial_as_json(best) if best else None,
    }
    write_json(summary, json_file)
    click.echo(trials_table(trials, best), err=str(json_file) == "-")
    if figure is not None:
        plotting.save(trade_off(trials, best, profile.motors), figure)
    if best is None:
        raise HframeError(
            "no candidate stays within the motors' limits: try larger --effort, or a slower print"
        )
    if output is not None:
        with OutputFile(output, sys.stdout.buffer) as file:
            file.write([with_windows(printer, best.windows).encode()], lambda: 0.0)


def _shaper(
    lines: Iterable[bytes], profile: Printer, file_limits: bool, json_file: Path | None
) -> None:
    """Prints the best input shaper there is, and what leaving it to Klipper would give."""
    from hframe_post.studies.shaping import calibrated, error, excerpt, search
    from hframe_post.studies.shaping_report import shapings_as_json, shapings_as_text

    path, counted = excerpt(lines, profile, file_limits)
    found = search(profile.plant, path, counted)
    usual = error(profile.plant, calibrated(profile.plant), path, counted)
    write_json(shapings_as_json(found, usual), json_file)
    click.echo(shapings_as_text(found, usual), err=str(json_file) == "-")
