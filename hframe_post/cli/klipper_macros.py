"""``hframe-post klipper-macros``: what printer.cfg needs beside a stream."""

from __future__ import annotations

import click

from hframe_post.cli.options import printer_option


@click.command("klipper-macros")
@printer_option
def klipper_macros(printer: str) -> None:
    """Print the macros for Klipper's printer.cfg, with this printer's limits.

    After a print that was cancelled or paused in mid-stream they bring the printer's own limits
    back, and the stream's on resuming. They replace macros of the same names.

    \b
    Example:
      hframe-post klipper-macros -p my.toml >> printer.cfg
    """
    from hframe_post.firmware.klipper.macros import macros
    from hframe_post.printer.profile import load

    click.echo(macros(load(printer)), nl=False)
