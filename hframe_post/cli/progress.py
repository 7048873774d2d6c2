"""What a running command shows: a progress bar, and with ``-v`` a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import click

BAR_FROM = 2_000_000  # bytes; smaller files take no time
START = time.monotonic()
_VERBOSE = "hframe_post.verbose"  # in a context's meta


@contextmanager
def progress_bar(source: Path, quiet: bool) -> Iterator[Callable[[int], object] | None]:
    """Show a progress bar on a terminal if the file is large.

    Yields the function to call with each number of bytes read; None if there is no bar.
    """
    size = source.stat().st_size if source.is_file() else 0
    if quiet or size < BAR_FROM or not sys.stderr.isatty():
        yield None
        return
    with click.progressbar(
        length=size, label=source.name, file=sys.stderr, update_min_steps=size // 200
    ) as bar:
        yield bar.update


def _set_verbose(context: click.Context, _: click.Parameter, verbose: bool) -> None:
    context.meta[_VERBOSE] = verbose


verbose_option = click.option(
    "-v", "--verbose", is_flag=True, expose_value=False, callback=_set_verbose,
    help="Log stages and their duration to standard error.",
)  # fmt: skip


def log(text: str) -> None:
    """Print a line with the seconds since the start, if the running command has ``-v``."""
    if click.get_current_context().meta.get(_VERBOSE):
        click.echo(f"{time.monotonic() - START:9.3f} s  {text}", err=True)


def log_stages(seconds: Mapping[str, float]) -> None:
    """Log the processor time of each stage, over all threads and processes."""
    total = sum(seconds.values())
    for stage, spent in seconds.items():
        log(f"  {stage:12s}{spent:8.3f} s of the processor{100.0 * spent / total:6.1f} %")
