"""``hframe-post verify``: proof on the machine that a profile helps it."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import click

from hframe_post.cli.options import (
    check_figure,
    figure_option,
    files_read,
    json_option,
    open_json,
    page_option,
    printer_option,
    say,
)
from hframe_post.cli.sensing import (
    FILE,
    QUIET,
    axes_option,
    chips_option,
    height_option,
    write_motion,
)


@click.command()
@printer_option
@click.option(
    "--gcode", type=click.Path(path_type=Path, dir_okay=False), metavar="VERIFY.GCODE",
    help="Write the test motion, plain and compensated; both commands go beside it, as CSV.",
)  # fmt: skip
@click.option(
    "--plain", type=(FILE, FILE), metavar="COMMAND RECORDING",
    help="What the sensor on the nozzle recorded of the plain motion.",
)  # fmt: skip
@click.option(
    "--compensated", type=(FILE, FILE), metavar="COMMAND RECORDING",
    help="The same of the compensated motion.",
)  # fmt: skip
@axes_option
@chips_option
@height_option
@page_option
@json_option
@figure_option("the contour error along the motion, as measured and as predicted")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="PROFILE.TOML",
    help="Write the profile with a mark of what was measured, if it is good.",
)  # fmt: skip
def verify(
    printer: str, gcode: Path | None, plain: tuple[Path, Path] | None,
    compensated: tuple[Path, Path] | None, axes: str, chips: tuple[str, ...], z: float,
    report_file: Path | None, json_file: Path | None, figure: Path | None, output: Path | None,
) -> None:  # fmt: skip
    """Check on the machine what a profile does: first --gcode, then both recordings.

    Status 1 if compensation does not help as the profile's model promises.

    \b
    Example:
      hframe-post verify -p my.toml --gcode verify.gcode
    """
    if gcode is not None:
        _write(printer, gcode, chips, z)
        return
    if plain is None or compensated is None:
        raise click.UsageError("give --gcode, or both --plain and --compensated")
    check_figure(figure)
    _judge(printer, plain, compensated, axes, report_file, json_file, figure, output)


def _write(printer: str, target: Path, chips: tuple[str, ...], z: float) -> None:
    from hframe_post.identification.verification.motion import runs
    from hframe_post.printer.profile import check_identified, load

    profile = load(printer)
    check_identified(profile)
    planned = runs(profile)
    write_motion(target, printer, profile, planned, chips, z)
    say("\n".join(f"{run.name}: {run.seconds:.1f} s" for run in planned))


def _judge(
    printer: str, plain: tuple[Path, Path], compensated: tuple[Path, Path], axes: str,
    report_file: Path | None, json_file: Path | None, figure: Path | None, output: Path | None,
) -> None:  # fmt: skip
    from hframe_post import plotting
    from hframe_post.errors import IdentificationError
    from hframe_post.identification import plots
    from hframe_post.identification.recordings import command_file
    from hframe_post.identification.recordings.accelerometer import oriented, read
    from hframe_post.identification.verification.compare import judge
    from hframe_post.identification.verification.page import verification_page
    from hframe_post.printer.edit import with_verification
    from hframe_post.printer.profile import load
    from hframe_post.writers.files.atomic_file import Outputs

    profile = load(printer)
    given = [*files_read(printer), *plain, *compensated]
    with Outputs(given) as marked:
        file = marked.open(output, Path(printer)) if output is not None else None
        with Outputs([*given, *([output] if output else [])]) as findings:
            write_json = open_json(findings, json_file)
            drawn = findings.open(report_file) if report_file is not None else None
            image = findings.open(figure) if figure is not None else None
            first, second = (
                (command_file.read(command), oriented(read(recording), axes, QUIET))
                for command, recording in (plain, compensated)
            )
            verdict = judge(profile, first, second)
            write_json(verdict.as_json())
            if drawn is not None:
                setup = [("plain", plain[1].name), ("compensated", compensated[1].name)]
                name = profile.description or profile.name
                drawn.write(verification_page(verdict, name, [*setup, ("axes", axes)]))
            if figure is not None and image is not None:
                plotting.save(plots.verification(verdict), image, figure.suffix.removeprefix("."))
        click.echo(verdict.as_text(), err=str(json_file) == "-")
        if verdict.fault is not None:
            raise IdentificationError(f"the profile is not verified: {verdict.fault}")
        if file is not None:
            recorded = datetime.fromtimestamp(compensated[1].stat().st_mtime, UTC)
            date = recorded.date().isoformat()
            file.write(with_verification(printer, date, verdict.reduction).encode())
