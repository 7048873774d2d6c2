"""A progress bar for a file that is read."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import click

BAR_FROM = 2_000_000  # bytes; smaller files take no time
UPDATE_EVERY = 50_000  # bytes


@contextmanager
def progress(file: IO[bytes], source: Path, quiet: bool) -> Iterator[Iterable[bytes]]:
    """Yield the file's lines, with a progress bar on a terminal if the file is large."""
    from hframe_post.gcode.lines import lines_of

    size = source.stat().st_size if source.is_file() else 0
    if quiet or size < BAR_FROM or not sys.stderr.isatty():
        yield lines_of(file)
        return
    with click.progressbar(
        length=size, label=source.name, file=sys.stderr, update_min_steps=UPDATE_EVERY
    ) as bar:

        def lines() -> Iterator[bytes]:
            for line in lines_of(file):
                bar.update(len(line))
                yield line

        yield lines()
