"""``hframe-post verify``: a test on the printer of whether its profile helps."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import click

from hframe_post.cli.options import (
    files_read,
    json_option,
    old_option,
    open_json,
    page_option,
    printer_option,
    say,
)
from hframe_post.cli.sweep import FILE, QUIET, chips_option, height_option, write_motion
from hframe_post.errors import IdentificationError
from hframe_post.printer.edit import with_verification
from hframe_post.printer.profile import check_identified, load
from hframe_post.writers.files import Outputs


@click.command()
@printer_option
@click.option(
    "--gcode", type=click.Path(path_type=Path, dir_okay=False), metavar="VERIFY.GCODE",
    help="Write the test motion, plain and compensated; both commands are written next to it.",
)  # fmt: skip
@click.option(
    "--plain", type=(FILE, FILE), metavar="COMMAND RECORDING",
    help="The plain motion's command (.csv), and what the sensor on the nozzle recorded of it.",
)  # fmt: skip
@click.option(
    "--compensated", type=(FILE, FILE), metavar="COMMAND RECORDING",
    help="The same two files of the compensated motion.",
)  # fmt: skip
@click.option(
    "--axes", default="x=x,y=y,z=z", show_default=True, metavar="MAP",
    help="The printer's axes as the nozzle's sensor names them, such as x=-y,y=x,z=z.",
)  # fmt: skip
@chips_option
@height_option
@page_option
@json_option
@old_option("--figure", "use --report page.html", removed=True)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), metavar="PROFILE.TOML",
    help="Write the profile, marked as verified, if the verdict is good.",
)  # fmt: skip
def verify(
    printer: str, gcode: Path | None, plain: tuple[Path, Path] | None,
    compensated: tuple[Path, Path] | None, axes: str, chips: tuple[str, ...], z: float | None,
    report_file: Path | None, json_file: Path | None, output: Path | None,
) -> None:  # fmt: skip
    """Check on the printer what a profile does: first --gcode, then both recordings.

    Exits with status 1 if compensation does not help as the profile's model predicts.

    \b
    Example:
      hframe-post verify -p my.toml --gcode verify.gcode
    """
    from hframe_post.identification.verification.motion import runs

    if gcode is not None:
        profile = load(printer)
        check_identified(profile)
        planned = runs(profile)
        write_motion(gcode, printer, profile, planned, chips, z)
        say("\n".join(f"{run.name}: {run.seconds:.1f} s" for run in planned))
        return
    if plain is None or compensated is None:
        raise click.UsageError("give --gcode, or both --plain and --compensated")
    _judge(printer, plain, compensated, axes, report_file, json_file, output)


def _judge(
    printer: str, plain: tuple[Path, Path], compensated: tuple[Path, Path], axes: str,
    report_file: Path | None, json_file: Path | None, output: Path | None,
) -> None:  # fmt: skip
    from hframe_post.identification.recordings.accelerometer import oriented, read
    from hframe_post.identification.recordings.excitation import read_command
    from hframe_post.identification.report import verification_page
    from hframe_post.identification.verification.verdict import judge

    profile = load(printer)
    sources = [*files_read(printer), *plain, *compensated]
    with Outputs(sources) as profiles:
        file = profiles.open(output, Path(printer)) if output is not None else None
        with Outputs([*sources, *([output] if output else [])]) as reports:
            write_json = open_json(reports, json_file)
            html = reports.open(report_file) if report_file is not None else None
            first, second = (
                (read_command(command), oriented(read(recording), axes, QUIET))
                for command, recording in (plain, compensated)
            )
            verdict = judge(profile, first, second)
            write_json(verdict.as_json())
            if html is not None:
                setup = [("plain", plain[1].name), ("compensated", compensated[1].name)]
                name = profile.description or profile.name
                html.write(verification_page(verdict, name, [*setup, ("axes", axes)]))
        click.echo(verdict.as_text(), err=str(json_file) == "-")
        if verdict.fault is not None:
            raise IdentificationError(f"the profile is not verified: {verdict.fault}")
        if file is not None:
            recorded = datetime.fromtimestamp(compensated[1].stat().st_mtime, UTC)
            date = recorded.date().isoformat()
            file.write(with_verification(printer, date, verdict.reduction).encode())
