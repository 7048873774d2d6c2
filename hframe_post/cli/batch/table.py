"""What is shown of jobs: a table that lives on a terminal, lines of what is done elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from hframe_post.cli.batch.job import Job
from hframe_post.cli.progress import left

if TYPE_CHECKING:
    from rich.table import Table

STYLES = {"done": "green", "failed": "bold red", "running": "yellow", "skipped": "dim",
          "waiting": "dim"}  # fmt: skip
ORDER = ("running", "failed", "done", "waiting", "skipped")


@contextmanager
def shown(jobs: list[Job], quiet: bool) -> Iterator[Callable[[Job | None], None]]:
    """What is called with each job that is finished, and with None now and then."""
    if quiet:
        yield lambda finished: None
    elif not sys.stderr.isatty():
        yield lambda finished: click.echo(finished.as_text(), err=True) if finished else None
    else:
        from rich.console import Console
        from rich.live import Live

        console = Console(stderr=True)
        sizes = [job.source.stat().st_size if not job.finished else 0 for job in jobs]
        began = time.monotonic()

        def table() -> Table:
            done = sum(size for size, job in zip(sizes, jobs, strict=True) if job.finished)
            told = left(done, sum(sizes), time.monotonic() - began)
            return _table(jobs, console.height, told)

        with Live(table(), console=console, auto_refresh=False) as live:
            yield lambda finished: live.update(table(), refresh=True)


def _table(jobs: list[Job], height: int, left_over: str) -> Table:
    """What runs and what failed before all else; as many rows as there is room for."""
    from rich.table import Table
    from rich.text import Text

    rows = sorted(jobs, key=lambda job: ORDER.index(job.state))
    room = max(height - 6, 3)
    table = Table("file", "state", "time", "contour error", box=None, padding=(0, 2, 0, 0))
    for job in rows[:room]:
        seconds = time.monotonic() - job.began if job.state == "running" else job.seconds
        told = job.error or job.error_predicted().removeprefix(", ")
        table.add_row(
            Text(job.source.name), Text(job.state, STYLES[job.state]),
            f"{seconds:.0f} s" if seconds else "", Text(told),
        )  # fmt: skip
    if len(rows) > room:
        table.add_row(Text(f"and {len(rows) - room} more", "dim"))
    finished = sum(job.finished for job in jobs)
    table.caption = f"{finished} of {len(jobs)}{left_over}"
    return table
