"""Options shared by sweep, identify and verify, and the files of a motion to be recorded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hframe_post.cli.options import files_read, old_option

if TYPE_CHECKING:
    from hframe_post.identification.recordings.sweep import Run
    from hframe_post.printer.settings import Printer

FILE = click.Path(path_type=Path, exists=True, dir_okay=False)  # that is read
QUIET = 0.5  # s at the start of a recording in which the printer stands still


def _chip(text: str) -> str:
    """Return a chip's name. Raise BadParameter unless Klipper takes it in CHIP=."""
    from hframe_post.identification.recordings.sweep import CHIP_NAME

    if not CHIP_NAME.fullmatch(text):
        raise click.BadParameter(
            f"{text!r} is not a chip's name: for [adxl345 hotend] in printer.cfg type hotend"
        )
    return text


chips_option = click.option(
    "--chip", "chips", type=_chip, multiple=True, default=("adxl345",), show_default=True,
    metavar="NAME", help="Accelerometer to record, by its name in Klipper; may be repeated.",
)  # fmt: skip

height_option = old_option(
    "--z", "edit the height in the line 'G1 Z10' of the G-code", metavar="MM",
    type=click.FloatRange(0.0, 1e4),
)  # fmt: skip


def write_motion(
    target: Path, printer: str, profile: Printer, planned: list[Run], chips: tuple[str, ...],
    z: float | None,
) -> None:  # fmt: skip
    """Write the runs as G-code, at height z (mm), and next to it each command as TARGET.RUN.csv."""
    from hframe_post.identification.recordings.excitation import command_csv
    from hframe_post.identification.recordings.sweep import gcode
    from hframe_post.writers.files import Outputs
    from hframe_post.writers.stream.print_time import write_output

    with Outputs(files_read(printer)) as outputs:
        motion = outputs.open(target)
        commands = [
            outputs.open(target.with_name(f"{target.stem}.{run.name}.csv")) for run in planned
        ]
        lines = gcode(profile, planned, tuple(dict.fromkeys(chips)), 10.0 if z is None else z)
        write_output(motion, lines, lambda: 0.0)
        for file, run in zip(commands, planned, strict=True):
            file.writelines(command_csv(run.command))
