"""``hframe-post paper``: the paper's figures, computed anew."""

from __future__ import annotations

from pathlib import Path

import click

from hframe_post.cli_options import printer_option


@click.command()
@printer_option
@click.option(
    "-o", "--output", "folder", type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the drawings (PNG and SVG) and tables.md; it is made if need be. "
    "Needs matplotlib: pip install 'hframe-post[plot]'.",
)  # fmt: skip
@click.option(
    "--prism", type=click.Path(path_type=Path), metavar="GCODE",
    help="Slice of the paper's prism for Fig. 11, such as sample_gcode/prism.gcode.",
)  # fmt: skip
def paper(printer: str, folder: Path | None, prism: Path | None) -> None:
    """Reproduce the paper's tables and figures with a printer's model.

    Prints the paper's numbers beside those computed here, and says which were calibrated.
    """
    import numpy as np

    from hframe_post import figures, paper, paper_tables
    from hframe_post.errors import PrinterError
    from hframe_post.printer import load

    profile = load(printer)
    if profile.plant.Gxtheta is None:
        raise PrinterError("the printer does not rack: nothing to reproduce", "plant", printer)
    lines: list[bytes] = []
    if prism is not None:  # say at once that it is missing
        with prism.open("rb") as file:
            lines = file.readlines()
    if folder is not None:
        figures.ready(folder)
    responses = paper.frequency_responses(profile.plant, np.geomspace(1.0, 200.0, 400))
    xy = paper.path(profile)
    approximations = paper.approximations(profile.plant, xy)
    time_responses = paper.time_responses(profile.plant, xy)
    tables = [
        paper_tables.coefficients(paper.coefficients_off(profile.plant)),
        paper_tables.approximation(approximations),
        paper_tables.time_response(time_responses),
        paper_tables.previews(paper.previews(profile, xy)),
    ]
    drawings = {}
    if folder is not None:
        drawings = {
            "fig04": figures.racking_response(responses),
            "fig05": figures.axis_responses(responses),
            "fig08": figures.approximation(approximations),
            "fig09": figures.time_response(time_responses),
        }
    if prism is not None:
        prisms = [paper.widths(profile, lines, printed) for printed in (False, True)]
        tables.append(paper_tables.width_errors(prisms))
        if folder is not None:
            drawings["fig11"] = figures.width_errors(prisms)
    text = "\n".join(tables)
    click.echo(text, nl=False)
    if folder is not None:
        figures.save_all(drawings, folder)
        (folder / "tables.md").write_text(text, encoding="utf-8")
