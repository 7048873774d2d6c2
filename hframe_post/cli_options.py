"""What commands share: options, the progress bar, JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import click

STRATEGIES = ("racking", "fbs", "none")
BAR_FROM = 2_000_000  # bytes of input that deserve a progress bar
BAR_EVERY = 500  # lines between its steps

printer_option = click.option(
    "-p", "--printer", default="paper", show_default=True, metavar="NAME|FILE",
    envvar="HFRAME_PRINTER", help="Profile: a shipped one's name, or a TOML file.",
)  # fmt: skip

limits_option = click.option(
    "--limits", type=click.Choice(["file", "printer"]), default="file", show_default=True,
    help="Whether M201, M203, M204, M205 and SET_VELOCITY_LIMIT in the file lower the "
    "profile's limits.",
)  # fmt: skip

json_option = click.option(
    "--json", "json_file", type=click.Path(path_type=Path, allow_dash=True, dir_okay=False),
    metavar="FILE", help="Write the summary as JSON; '-' for standard output.",
)  # fmt: skip


def write_json(summary: dict[str, Any], path: Path | None) -> None:
    """The summary, indented, to a file or standard output; None: nowhere."""
    if path is not None:
        with click.open_file(str(path), "w", encoding="utf-8") as file:
            file.write(json.dumps(summary, indent=2) + "\n")


@contextmanager
def progress(file: IO[bytes], source: Path, quiet: bool) -> Iterator[Iterable[bytes]]:
    """The file's lines, with a bar on a terminal if there are many."""
    size = source.stat().st_size if source.is_file() else 0
    if quiet or size < BAR_FROM or not sys.stderr.isatty():
        yield file
        return
    with click.progressbar(length=size, label=source.name, file=sys.stderr) as bar:

        def lines() -> Iterator[bytes]:
            read = 0
            for number, line in enumerate(file):
                read += len(line)
                if number % BAR_EVERY == 0:
                    bar.update(read)
                    read = 0
                yield line
            bar.update(read)

        yield lines()
