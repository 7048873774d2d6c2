"""``hframe-post tune``: which λ and L for this printer and this kind of print."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
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
    from hframe_post.conversion.pipeline import Options
    from hframe_post.gcode.options import Extrusion, LimitSource
    from hframe_post.library import Tuning
    from hframe_post.printer.settings import Printer
    from hframe_post.studies.tuning.pareto import Pareto
    from hframe_post.studies.tuning.tune import Trial

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
    "--model-error", type=share, metavar="PERCENT",
    help="Printers drawn around the model, on which the recommendation must be good too. Default: "
    "the profile's plant.uncertainty, which `identify` measures, or 5%.",
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
    "--keep-limits", is_flag=True,
    help="Choose window and weight alone: acceleration and jerk stay the profile's.",
)  # fmt: skip
@click.option(
    "--shaper", is_flag=True,
    help="Instead, for those who want no dense stream: the [input_shaper] section for Klipper's "
    "printer.cfg that serves this printer and print best.",
)  # fmt: skip
@json_option
def tune(
    source: Path | None, path: str | None, printer: str, limits: LimitSource,
    extrusion: Extrusion | None, knots: tuple[int, ...], effort: tuple[float, ...],
    model_error: float | None, draws: int, seed: int, figure: Path | None, output: Path | None,
    keep_limits: bool, shaper: bool, json_file: Path | None,
) -> None:  # fmt: skip
    """Try windows and weights on a print, and recommend the best the motors can follow.

    More weight (λ) drives the motors less hard and leaves more error; finer knots (small L)
    can cancel faster ringing. Of those whose error, under model error, is within a tenth of the
    best the gentlest is taken. Then acceleration and jerk are chosen with them, on half a minute
    of the print: gentler ones as long as they halve the error for a tenth of the time.
    The settings of compensation.stops are shown with the print time that each takes.

    \b
    Example:
      hframe-post tune in.gcode -p my.toml -o my.toml
    """
    from hframe_post import library, plotting
    from hframe_post.conversion.pipeline import Options
    from hframe_post.errors import HframeError
    from hframe_post.studies.tuning.plots import trade_off
    from hframe_post.studies.tuning.report import (
        pace_as_json,
        pace_table,
        stops_table,
        summary,
        trials_table,
    )
    from hframe_post.writers.files.atomic_file import Outputs

    profile = library.load_printer(printer)
    model_error = library.model_uncertainty(profile) if model_error is None else model_error
    reads = files_read(source, printer)
    if shaper:
        if figure is not None or output is not None:
            raise click.UsageError("--shaper writes neither figure nor profile")
        options = Options("none", limits=limits, extrusion=extrusion)
        with opened(source, path, profile, quiet=False) as lines, Outputs(reads) as findings:
            _tell_shaper(lines, profile, options, open_json(findings, json_file), json_file)
        return
    check_figure(figure)
    asked = _Asked(knots, effort, model_error, draws, seed, limits, extrusion)
    with Outputs(reads) as recommendation:
        file = recommendation.open(output, Path(printer)) if output is not None else None
        with Outputs([*reads, *([output] if output else [])]) as findings:
            write_json = open_json(findings, json_file)
            drawing = findings.open(figure) if figure is not None else None
            with opened(source, path, profile, quiet=False) as lines:
                tuned = asked.tuned(lines, profile)
            windows_alone = keep_limits or str(source) == "-"
            pace = None if windows_alone else asked.paced(source, tuned, profile)
            told = summary(tuned.trials, tuned.best, model_error, draws, tuned.stops)
            write_json(told | (pace_as_json(pace) if pace else {}))
            if figure is not None and drawing is not None:
                drawn = trade_off(tuned.trials, tuned.best, profile.motors, pace)
                plotting.save(drawn, drawing, figure.suffix.removeprefix("."))
        table = trials_table(tuned.trials, tuned.best) + (pace_table(pace) if pace else "")
        if tuned.stops:
            table += f"\n\n{stops_table(tuned.stops, profile.compensation.stops)}"
        click.echo(table, err=str(json_file) == "-")
        if tuned.best is None:
            raise HframeError(NO_CANDIDATE)
        if file is not None:
            file.write(_written(printer, tuned.best, pace).encode())


def _written(printer: str, best: Trial, pace: Pareto | None) -> str:
    """The profile with what is recommended."""
    from hframe_post.printer.edit import with_windows

    if pace is None or pace.chosen is None:
        return with_windows(printer, best.windows)
    chosen = pace.chosen
    limits = {"acceleration": chosen.acceleration, "jerk": chosen.jerk}
    return with_windows(printer, chosen.trial.windows, limits)


@dataclass(frozen=True, slots=True)
class _Asked:
    """What is tried, and on which printers."""

    knots: tuple[int, ...]
    effort: tuple[float, ...]
    model_error: float
    draws: int
    seed: int
    limits: LimitSource
    extrusion: Extrusion | None

    def tuned(self, lines: Iterable[bytes], profile: Printer) -> Tuning:
        """Windows and weights, as the profile plans the print."""
        from hframe_post import library
        from hframe_post.studies.tuning.tune import EFFORTS, KNOTS

        return library.tune(
            lines, profile, knots=self.knots or KNOTS, efforts=self.effort or EFFORTS,
            model_error=self.model_error, draws=self.draws, seed=self.seed, limits=self.limits,
            extrusion=self.extrusion,
        )  # fmt: skip

    def paced(self, source: Path | None, tuned: Tuning, profile: Printer) -> Pareto | None:
        """The best windows with other accelerations and jerks; None if there is no best."""
        from hframe_post.studies.simulation.reference_path import rectangle
        from hframe_post.studies.simulation.uncertainty import draws
        from hframe_post.studies.tuning import pareto

        if tuned.best is None:
            return None
        grid = pareto.windows(tuned.trials, tuned.best, profile.motors)
        plants = draws(profile.plant, self.model_error, self.draws, self.seed)
        if source is None:
            kept = pareto.pieces(rectangle(profile), profile)
        else:
            with source.open("rb") as lines:
                kept = pareto.pieces(lines, profile)
        return pareto.pareto(kept, profile, grid, plants)


def _tell_shaper(
    lines: Iterable[bytes], profile: Printer, options: Options,
    write_json: Callable[[dict[str, Any]], None], json_file: Path | None,
) -> None:  # fmt: skip
    """The best input shaper there is, and what leaving it to Klipper would give."""
    from hframe_post.studies.shapers.report import shapings_as_json, shapings_as_text
    from hframe_post.studies.shapers.shapers import calibrated, error, paths, search

    pieces = paths(lines, profile, options)
    found = search(profile.plant, pieces)
    usual = error(profile.plant, calibrated(profile.plant), pieces)
    write_json(shapings_as_json(found, usual))
    click.echo(shapings_as_text(found, usual), err=str(json_file) == "-")
