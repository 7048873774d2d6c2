"""``hframe-post paper``: reproduce the paper's tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from hframe_post.errors import PrinterError
from hframe_post.paper import tables
from hframe_post.printer.choice import DEMONSTRATIONS
from hframe_post.printer.profile import load


@click.command()
@click.option(
    "-p", "--printer", default=DEMONSTRATIONS[0], show_default=True, metavar="NAME|FILE",
    help="Another printer's profile, shipped or in a TOML file.",
)  # fmt: skip
@click.option(
    "--prism", type=click.Path(path_type=Path), metavar="GCODE",
    help="A slice of the paper's prism, for Fig. 11: sample_gcode/prism.gcode.",
)  # fmt: skip
def paper(printer: str, prism: Path | None) -> None:
    """Reproduce the paper's tables with a printer's model.

    Prints the paper's numbers next to the computed ones, and marks the calibrated ones.

    \b
    Example:
      hframe-post paper
    """
    profile = load(printer)
    # the paper knows no coupling but racking
    profile = replace(profile, plant=replace(profile.plant, cross=()))
    if profile.plant.Gxtheta is None:
        raise PrinterError(
            "this printer does not rack, so there is nothing to reproduce; without -p the "
            "paper's printer is used",
            "plant",
            printer,
        )
    lines = prism.read_bytes().splitlines(keepends=True) if prism is not None else None
    click.echo(tables.computed(profile, lines), nl=False)
