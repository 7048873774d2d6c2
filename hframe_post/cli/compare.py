"""``hframe-post compare``: do two files make a printer do the same?"""

from __future__ import annotations

import math
from pathlib import Path

import click

from hframe_post.cli.json_summary import json_option, open_json
from hframe_post.cli.options import files_read, number, typed
from hframe_post.conversion.options import known_firmware
from hframe_post.firmware.registry import FIRMWARES
from hframe_post.gcode.lines import lines_of
from hframe_post.studies.print_comparison import Tolerance
from hframe_post.studies.print_comparison import compare as compare_files
from hframe_post.writers.outputs import Outputs

LENGTHS = {"nm": 1e-6, "um": 1e-3, "µm": 1e-3, "mm": 1.0}
TIMES = {"us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0}
FILE = click.Path(path_type=Path, allow_dash=True)


def tolerance(text: str) -> Tolerance:
    """Read ``1um``, or ``1um,1ms``."""
    place, comma, slack = text.partition(",")
    if not comma:
        return Tolerance(quantity(place, LENGTHS))
    return Tolerance(quantity(place, LENGTHS), quantity(slack, TIMES))


def quantity(text: str, units: dict[str, float]) -> float:
    """Read a positive number with one of these units. Raises BadParameter."""
    unit = next((each for each in units if text.endswith(each)), "")
    value = number(text.removesuffix(unit)) * units.get(unit, math.nan)
    if not 0.0 < value < 1e3:
        if number(text) > 0.0:
            choices = " or ".join(text + each for each in units if each.isascii())
            raise click.BadParameter(f"{text!r} has no unit: type {choices}")
        raise click.BadParameter(f"{text!r} is not a positive number of {', '.join(units)}")
    return value


@click.command()
@click.argument("a", type=FILE)
@click.argument("b", type=FILE)
@click.option(
    "--tolerance", type=tolerance, default="1um,1ms", show_default=True, metavar="LENGTH[,TIME]",
    help="Allowed difference in position and filament (nm, um, mm), and in the time at which a "
    "position is reached (us, ms, s).",
)  # fmt: skip
@click.option(
    "--firmware", type=typed(known_firmware), default="klipper", show_default=True, metavar="NAME",
    help="Firmware that reads the files: klipper or marlin. G90 and G91 "
    "affect E in Marlin, but not in Klipper.",
)  # fmt: skip
@json_option
@click.option("-q", "--quiet", is_flag=True, help="Print nothing; see the exit status.")
@click.pass_context
def compare(
    context: click.Context, a: Path, b: Path, tolerance: Tolerance, firmware: str,
    json_file: Path | None, quiet: bool,
) -> None:  # fmt: skip
    """Compare the motion of two G-code files, and their other lines.

    The motion is the same if position, filament and time agree, however it is cut into moves. The
    first line written by hframe-post is ignored, and so are numbers in lines that announce the
    print time. Exit status: 0 if the files are the same, 1 if they differ (the first difference is
    printed), 2 for wrong usage or a file that cannot be read.

    \b
    Example:
      hframe-post compare golden/part.gcode out/part.gcode --tolerance 1um
    """
    if str(a) == str(b) == "-":
        raise click.UsageError("only one of the two files can be standard input")
    with (
        click.open_file(str(a), "rb") as first,
        click.open_file(str(b), "rb") as second,
        Outputs(files_read(a, b)) as outputs,
    ):
        write_json = open_json(outputs, json_file)
        dialect = FIRMWARES[firmware].dialect
        result = compare_files(lines_of(first), lines_of(second), dialect, tolerance)
        status = 0 if result.same else 1
        write_json(result.as_json(), status)
    if not quiet:
        click.echo(result.as_text(), err=str(json_file) == "-")
    context.exit(status)
