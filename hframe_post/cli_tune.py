"""``hframe-post tune``: which λ and L for this printer and this kind of print."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hframe_post.cli_options import (
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

if TYPE_CHECKING:
    from hframe_post.tune import Trial


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
@json_option
def tune(
    source: Path | None, path: str | None, printer: str, limits: str, knots: tuple[int, ...],
    effort: tuple[float, ...], model_error: float, draws: int, seed: int, figure: Path | None,
    output: Path | None, json_file: Path | None,
) -> None:  # fmt: skip
    """Try windows and weights on a print, and recommend the best the motors can follow.

    More weight (λ) drives the motors less hard and leaves more error; finer knots (small L)
    can cancel faster ringing. Recommended is the gentlest of those whose error, under model
    error, is within a tenth of the best.
    """
    from hframe_post import figures
    from hframe_post.errors import HframeError
    from hframe_post.output import OutputFile
    from hframe_post.printer import load
    from hframe_post.profile_text import with_windows
    from hframe_post.tune import EFFORTS, KNOTS, candidates, recommended
    from hframe_post.tune import tune as tuning
    from hframe_post.uncertainty import draws as drawn

    profile = load(printer)
    if figure is not None:
        if figure.suffix not in (".png", ".svg"):
            raise click.UsageError("--figure must end in .png or .svg")
        figures.canvas(1, 1, (1.0, 1.0))  # say at once that matplotlib is missing
    grid = candidates(profile.compensation, knots or KNOTS, effort or EFFORTS)
    plants = drawn(profile.plant, model_error, draws, seed)
    with opened(source, path, profile, quiet=False) as lines:
        trials = tuning(lines, profile, grid, plants, limits == "file")
    best = recommended(trials, profile.motors)
    summary: dict[str, Any] = {
        "model_error": model_error if draws else 0.0,
        "draws": draws,
        "trials": [_as_json(trial) for trial in trials],
        "recommended": _as_json(best) if best else None,
    }
    write_json(summary, json_file)
    click.echo(_table(trials, best), err=str(json_file) == "-")
    if figure is not None:
        figures.save(figures.trade_off(trials, best, profile.motors), figure)
    if best is None:
        raise HframeError(
            "no candidate stays within the motors' limits: try larger --effort, or a slower print"
        )
    if output is not None:
        with OutputFile(output, sys.stdout.buffer) as file:
            file.write([with_windows(printer, best.windows).encode()], lambda: 0.0)


def _as_json(trial: Trial) -> dict[str, Any]:
    x, y = trial.windows
    told: dict[str, Any] = {
        "L": x.L, "n_C": x.n_C, "n_up": x.n_up, "effort": [x.effort, y.effort],
    }  # fmt: skip
    if trial.refused:
        return told | {"refused": trial.refused}
    return told | {
        "contour_error_um": trial.contour.micrometres(),
        "median_under_model_error_um": round(trial.robust * 1e3, 4),
        "peak_belt_speed": round(trial.velocity, 3),
        "peak_belt_acceleration": round(trial.acceleration, 1),
    }


def _table(trials: list[Trial], best: Trial | None) -> str:
    """All trials, the recommended one marked."""
    lines = [
        f"{'':2s}{'':3s}{'effort (λ)':>16s}{'contour error, µm RMS':>26s}{'belts, at most':>21s}",
        f"{'':2s}{'L':>3s}{'x, y':>16s}{'the model':>12s}{'model error':>14s}{'mm/s':>10s}"
        f"{'mm/s²':>11s}",
    ]
    for trial in trials:
        x, y = trial.windows
        row = f"{'→' if trial is best else '':2s}{x.L:3d}{f'{x.effort:g}, {y.effort:g}':>16s}"
        if trial.refused:
            lines.append(f"{row}  refused: {trial.refused.partition(' with ')[0]}")
        else:
            lines.append(
                f"{row}{trial.contour.rms * 1e3:12.2f}{trial.robust * 1e3:14.2f}"
                f"{trial.velocity:10.0f}{trial.acceleration:11.0f}"
            )
    if best is not None:
        x, y = best.windows
        lines += [
            "",
            f"recommended: L = {x.L}, n_C = {x.n_C}, n_up = {x.n_up}, "
            f"effort = [{x.effort:g}, {y.effort:g}]",
        ]
    return "\n".join(lines)
