"""``hframe-post simulate``: what would it do for this part, and how far to trust that."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hframe_post.cli.options import (
    chosen_printer,
    files_read,
    json_option,
    on_limit_option,
    open_json,
    opened,
    print_options,
    seed_option,
    share,
)
from hframe_post.cli.verbose import log, log_stages, verbose_option

if TYPE_CHECKING:
    from hframe_post.gcode.options import Extrusion, LimitSource
    from hframe_post.printer.settings import Printer
    from hframe_post.studies.shapers.rivals import Rival


@click.command()
@print_options
@on_limit_option
@click.option(
    "--plant", "plant_file", metavar="NAME|FILE",
    help="Profile whose [plant] is simulated, where it is not the one compensated for.",
)  # fmt: skip
@click.option(
    "--model-error", "shares", type=share, multiple=True, metavar="PERCENT",
    help="Also simulate printers whose frequencies, damping and racking gain are off by up to "
    "so much. May be repeated.",
)  # fmt: skip
@click.option(
    "--draws", type=click.IntRange(1, 1000), default=50, show_default=True,
    help="How many printers to draw for each model error.",
)  # fmt: skip
@seed_option
@click.option("--steps", is_flag=True, help="Put the motors' steps between command and plant.")
@click.option(
    "--against", type=click.Choice(["shapers"]),
    help="Also what each input shaper would do: with the frequencies and damping that serve this "
    "printer best, and as Klipper's own calibration would place it.",
)  # fmt: skip
@click.option("--layers", is_flag=True, help="Show every layer, not the worst.")
@json_option
@click.option(
    "--report", "report_file", type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.HTML", help="Write a page with a view of the layers by predicted error.",
)  # fmt: skip
@verbose_option
@click.option("-q", "--quiet", is_flag=True, help="No summary, no progress bar.")
def simulate(
    source: Path | None, path: str | None, printer: str, limits: LimitSource,
    extrusion: Extrusion | None, on_limit: str, plant_file: str | None,
    shares: tuple[float, ...], draws: int, seed: int, steps: bool, against: str | None,
    layers: bool, json_file: Path | None, report_file: Path | None, quiet: bool,
) -> None:  # fmt: skip
    """Simulate a print with no compensation, without and with racking compensation.

    Contour error is the distance of the nozzle to the slicer's path; tracking error is how far
    it is from where it should be at that time. Nothing is written but the summary.

    \b
    Example:
      hframe-post simulate in.gcode -p my.toml --model-error 5%
    """
    from hframe_post import library
    from hframe_post.conversion.pipeline import Options
    from hframe_post.page.build import page
    from hframe_post.studies.shapers.report import rivals_as_json, rivals_as_text
    from hframe_post.writers.files.atomic_file import Outputs

    if report_file is not None and (source is None or str(source) == "-"):
        raise click.UsageError("a page needs a file to read twice")
    if against and str(source) == "-":
        raise click.UsageError("--against reads the file several times: name one")
    profile = library.load_printer(printer)
    simulated = library.load_printer(plant_file) if plant_file else profile
    with (
        opened(source, path, profile, quiet) as lines,
        Outputs(files_read(source, printer, plant_file)) as outputs,
    ):
        write_json = open_json(outputs, json_file)
        log(f"profile {printer}; simulation of all strategies")
        report = library.simulate(
            lines, profile, simulated=simulated, model_error=shares, draws=draws, seed=seed,
            steps=steps, limits=limits, extrusion=extrusion, clamp=on_limit == "clamp",
        )  # fmt: skip
        log(f"{report.read.lines} lines are simulated")
        log_stages(report.seconds)
        found = _rivals(source, profile, limits, extrusion) if against else []
        told = [chosen_printer().as_text(), report.as_text(layers)]
        if found:
            told.append(rivals_as_text(found))
        beside = {"against": rivals_as_json(found)} if found else {}
        write_json({**chosen_printer().as_json(), **report.as_json(), **beside})
        if report_file is not None and source is not None:
            options = Options("racking", (), limits, on_limit == "clamp", extrusion=extrusion)
            log("page: the simulation once more")
            with source.open("rb") as again:
                outputs.open(report_file).write(
                    page(again, profile, options, source.name, told[:1], simulated)
                )
    if not quiet:
        click.echo("\n".join(told), err=str(json_file) == "-")


def _rivals(
    source: Path | None, profile: Printer, limits: LimitSource, extrusion: Extrusion | None
) -> list[Rival]:
    """What input shapers would do for the print; of the path if no file is given."""
    from hframe_post.conversion.pipeline import Options
    from hframe_post.studies.shapers.rivals import rivals
    from hframe_post.studies.simulation.reference_path import rectangle

    def lines() -> Iterator[bytes]:
        if source is None:
            yield from rectangle(profile)
        else:
            with source.open("rb") as file:
                yield from file

    log("input shapers: search and simulation")
    return rivals(lines, profile, Options("racking", (), limits, True, extrusion=extrusion))
