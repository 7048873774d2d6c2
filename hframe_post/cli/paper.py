"""``hframe-post paper``: the paper's figures, computed anew."""

from __future__ import annotations

from pathlib import Path

import click

from hframe_post.cli.options import files_read, printer_option


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

    \b
    Example:
      hframe-post paper
    """
    import numpy as np

    from hframe_post import plotting
    from hframe_post.errors import PrinterError
    from hframe_post.paper import plots, results, tables
    from hframe_post.printer.profile import load
    from hframe_post.writers.atomic_file import Outputs

    profile = load(printer)
    if profile.plant.Gxtheta is None:
        raise PrinterError("the printer does not rack: nothing to reproduce", "plant", printer)
    lines: list[bytes] = []
    if prism is not None:  # say at once that it is missing
        with prism.open("rb") as file:
            lines = file.readlines()
    if folder is not None:
        plotting.ready(folder)
    responses = results.frequency_responses(profile.plant, np.geomspace(1.0, 200.0, 400))
    xy = results.path(profile)
    approximations = results.approximations(profile.plant, xy)
    time_responses = results.time_responses(profile.plant, xy)
    told = [
        tables.coefficients(results.coefficients_off(profile.plant)),
        tables.approximation(approximations),
        tables.time_response(time_responses),
        tables.previews(results.previews(profile, xy)),
    ]
    drawings = {}
    if folder is not None:
        drawings = {
            "fig04": plots.racking_response(responses),
            "fig05": plots.axis_responses(responses),
            "fig08": plots.approximation(approximations),
            "fig09": plots.time_response(time_responses),
            "corner": plots.corner(time_responses),
        }
    if prism is not None:
        prisms = [results.widths(profile, lines, printed) for printed in (False, True)]
        told.append(tables.width_errors(prisms))
        if folder is not None:
            drawings["fig11"] = plots.width_errors(prisms)
    text = "\n".join(told)
    click.echo(text, nl=False)
    if folder is not None:
        with Outputs(files_read(printer, prism)) as outputs:
            plotting.save_all(drawings, lambda name: outputs.open(folder / name))
            outputs.open(folder / "tables.md").write(text.encode())
