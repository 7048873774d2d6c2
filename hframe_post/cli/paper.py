"""``hframe-post paper``: reproduce the paper's tables and figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from hframe_post import plotting
from hframe_post.cli.options import files_read
from hframe_post.errors import PrinterError
from hframe_post.paper import plots, results, tables
from hframe_post.paper.widths import widths
from hframe_post.printer.choice import DEMONSTRATIONS
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from hframe_post.stream.running import one_blas_thread
from hframe_post.writers.files import Outputs

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@click.command()
@click.option(
    "-p", "--printer", default=DEMONSTRATIONS[0], show_default=True, metavar="NAME|FILE",
    help="Another printer's profile, shipped or in a TOML file.",
)  # fmt: skip
@click.option(
    "-o", "--output", "folder", type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the figures (PNG and SVG) and tables.md, created if necessary. Needs "
    "matplotlib.",
)  # fmt: skip
@click.option(
    "--prism", type=click.Path(path_type=Path), metavar="GCODE",
    help="A slice of the paper's prism, for Fig. 11: sample_gcode/prism.gcode.",
)  # fmt: skip
def paper(printer: str, folder: Path | None, prism: Path | None) -> None:
    """Reproduce the paper's tables and figures with a printer's model.

    Prints the paper's numbers next to the computed ones, and marks the calibrated ones.

    \b
    Example:
      hframe-post paper
    """
    profile = load(printer)
    plant = replace(profile.plant, cross=())  # the paper knows no coupling but racking
    profile = replace(profile, plant=plant)
    if profile.plant.Gxtheta is None:
        raise PrinterError(
            "this printer does not rack, so there is nothing to reproduce; without -p the "
            "paper's printer is used",
            "plant",
            printer,
        )
    lines = prism.read_bytes().splitlines(keepends=True) if prism is not None else None
    if folder is not None:
        plotting.ready(folder)
    text, drawings = _compute(profile, lines)
    click.echo(text, nl=False)
    if folder is not None:
        with Outputs(files_read(printer, prism)) as outputs:
            drawn = {name: draw() for name, draw in drawings.items()}
            plotting.save_all(drawn, lambda name: outputs.open(folder / name))
            outputs.open(folder / "tables.md").write(text.encode())


@one_blas_thread()
def _compute(
    profile: Printer, prism: list[bytes] | None
) -> tuple[str, dict[str, Callable[[], Figure]]]:
    """Return the tables, and a function that draws each figure. prism: the slice's lines."""
    responses = results.frequency_responses(profile.plant, np.geomspace(1.0, 200.0, 400))
    xy = results.path(profile)
    approximations = results.approximations(profile.plant, xy)
    time_responses = results.time_responses(profile.plant, xy)
    texts = [
        tables.coefficients(tables.coefficients_off(profile.plant)),
        tables.approximation(approximations),
        tables.time_response(time_responses),
        tables.previews(results.previews(profile, xy)),
    ]
    drawings: dict[str, Callable[[], Figure]] = {
        "fig04": partial(plots.racking_response, responses),
        "fig05": partial(plots.axis_responses, responses),
        "fig08": partial(plots.approximation, approximations),
        "fig09": partial(plots.time_response, time_responses),
        "corner": partial(plots.corner, time_responses),
    }
    if prism is not None:
        prisms = [widths(profile, prism, printed) for printed in (False, True)]
        texts.append(tables.width_errors(prisms))
        drawings["fig11"] = partial(plots.width_errors, prisms)
    return "\n".join(texts), drawings
