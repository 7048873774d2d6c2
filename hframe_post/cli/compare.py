"""``hframe-post compare``: do two files ask a printer for the same?"""

from __future__ import annotations

from pathlib import Path

import click

from hframe_post.cli.options import FirmwareChoice, files_read, json_option, open_json

LENGTHS = {"nm": 1e-6, "um": 1e-3, "µm": 1e-3, "mm": 1.0}
TIMES = {"us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0}
FILE = click.Path(path_type=Path, allow_dash=True)


def length(text: str) -> float:
    """``1um`` in mm; a number alone is in mm."""
    return _quantity(text, LENGTHS)


def seconds(text: str) -> float:
    """``1ms`` in s; a number alone is in s."""
    return _quantity(text, TIMES)


def _quantity(text: str, units: dict[str, float]) -> float:
    unit = next((each for each in units if text.endswith(each)), "")
    try:
        value = float(text.removesuffix(unit)) * units.get(unit, 1.0)
    except ValueError:
        value = -1.0
    if not 0.0 < value < 1e3:
        raise click.BadParameter(f"{text!r} is no positive number of {', '.join(units)}")
    return value


@click.command()
@click.argument("a", type=FILE)
@click.argument("b", type=FILE)
@click.option(
    "--tolerance", type=length, default="1um", show_default=True, metavar="LENGTH",
    help="How far the paths may be apart, and filament (nm, um, mm).",
)  # fmt: skip
@click.option(
    "--slack", type=seconds, default="1ms", show_default=True, metavar="TIME",
    help="How much earlier or later a place may be reached (us, ms, s).",
)  # fmt: skip
@click.option(
    "--firmware", type=FirmwareChoice(), default="klipper", show_default=True,
    help="Who reads the files: after G90 and G91, E means another thing to Marlin.",
)  # fmt: skip
@json_option
@click.option("-q", "--quiet", is_flag=True, help="Say nothing; the exit status tells.")
@click.pass_context
def compare(
    context: click.Context, a: Path, b: Path, tolerance: float, slack: float, firmware: str,
    json_file: Path | None, quiet: bool,
) -> None:  # fmt: skip
    """Compare two G-code files: the same motion, and the same lines otherwise?

    Motion is compared in place, filament and time (length over feed rate), however it is cut
    into moves. The stamp of this tool is left out, and numbers of lines that tell of print
    time may differ. Exit status 0: the same; 1: different, with the first difference; 2: wrong
    usage.

    \b
    Example:
      hframe-post compare golden/part.gcode out/part.gcode --tolerance 1um
    """
    from hframe_post.gcode.commands import dialect
    from hframe_post.studies.comparison.compare import Tolerance
    from hframe_post.studies.comparison.compare import compare as compared
    from hframe_post.writers.files.atomic_file import Outputs

    if str(a) == str(b) == "-":
        raise click.UsageError("only one of the two can be standard input")
    with (
        click.open_file(str(a), "rb") as first,
        click.open_file(str(b), "rb") as second,
        Outputs(files_read(a, b)) as outputs,
    ):
        write_json = open_json(outputs, json_file)
        result = compared(first, second, dialect(firmware), Tolerance(tolerance, slack))
        write_json(result.as_json())
    if not quiet:
        click.echo(result.as_text(), err=str(json_file) == "-")
    context.exit(0 if result.same else 1)
