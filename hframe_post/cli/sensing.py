"""What the commands share that play motions for an accelerometer and read what it recorded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hframe_post.cli.options import files_read

if TYPE_CHECKING:
    from hframe_post.identification.recordings.sweep import Run
    from hframe_post.printer.settings import Printer

FILE = click.Path(path_type=Path, exists=True, dir_okay=False)  # that is read
QUIET = 0.5  # s at the start of a recording in which only gravity is felt


def chip(text: str) -> str:
    """A name as Klipper takes it in CHIP=."""
    from hframe_post.identification.recordings.sweep import NAME

    if not NAME.fullmatch(text):
        raise click.BadParameter(
            f"{text!r} is no name: of [adxl345 hotend] in printer.cfg it is hotend"
        )
    return text


axes_option = click.option(
    "--axes", default="x=x,y=y,z=z", show_default=True, metavar="MAP",
    help="The printer's axes as the nozzle's sensor names them, such as x=-y,y=x,z=z.",
)  # fmt: skip

chips_option = click.option(
    "--chip", "chips", type=chip, multiple=True, default=("adxl345",), show_default=True,
    metavar="NAME", help="An accelerometer to record, as Klipper calls it; may be repeated.",
)  # fmt: skip

height_option = click.option(
    "--z", type=click.FloatRange(0.0, 1e4), default=10.0, show_default=True, metavar="MM",
    help="Height at which to move.",
)  # fmt: skip


def write_motion(
    target: Path, printer: str, profile: Printer, planned: list[Run], chips: tuple[str, ...],
    z: float,
) -> None:  # fmt: skip
    """The runs as G-code, and beside it the command of each, as TARGET.RUN.csv."""
    from hframe_post.identification.recordings import command_file
    from hframe_post.identification.recordings.sweep import gcode
    from hframe_post.writers.files.atomic_file import Outputs
    from hframe_post.writers.stream.print_time import write_output

    with Outputs(files_read(printer)) as outputs:
        motion = outputs.open(target)
        commands = [
            outputs.open(target.with_name(f"{target.stem}.{run.name}.csv")) for run in planned
        ]
        lines = gcode(profile, planned, tuple(dict.fromkeys(chips)), z)
        write_output(motion, lines, lambda: 0.0)
        for file, run in zip(commands, planned, strict=True):
            file.writelines(command_file.written(run.command))
