"""How far a command is: a bar on a terminal, with rate and time left."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

BAR_FROM = 2_000_000  # bytes of input that deserve a progress bar
BAR_EVERY = 500  # lines between its steps


@contextmanager
def progress(file: IO[bytes], source: Path, quiet: bool) -> Iterator[Iterable[bytes]]:
    """The file's lines, with a bar on a terminal if there are many."""
    from hframe_post.gcode.lines import lines_of

    size = source.stat().st_size if source.is_file() else 0
    if quiet or size < BAR_FROM or not sys.stderr.isatty():
        yield lines_of(file)
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
        TransferSpeedColumn,
    )

    columns = (
        TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(),
        TransferSpeedColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(source.name, total=size)

        def lines() -> Iterator[bytes]:
            read = 0
            for number, line in enumerate(lines_of(file)):
                read += len(line)
                if number % BAR_EVERY == 0:
                    bar.advance(task, read)
                    read = 0
                yield line
            bar.advance(task, read)

        yield lines()


def left(done: int, whole: int, seconds: float) -> str:
    """Rate and time left of work that is measured in bytes; empty where nothing tells yet."""
    if not 0 < done < whole or seconds <= 0.0:
        return ""
    rest = round(seconds * (whole - done) / done)
    clock = f"{rest // 60} min {rest % 60} s" if rest >= 60 else f"{rest} s"
    return f", {done / seconds / 1e6:.1f} MB/s, about {clock} left"
