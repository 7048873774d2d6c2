"""``-v``: what is being done, when it begins, and what each stage took."""

from __future__ import annotations

import time
from collections.abc import Mapping

import click

BEGUN = time.monotonic()
_META = "hframe_post.verbose"


def _take(context: click.Context, parameter: click.Parameter, verbose: bool) -> None:
    context.meta[_META] = verbose


verbose_option = click.option(
    "-v", "--verbose", is_flag=True, expose_value=False, callback=_take,
    help="Log stages and timing to standard error.",
)  # fmt: skip


def log(text: str) -> None:
    """A line with the seconds since the start, if the running command was asked to log."""
    if click.get_current_context().meta.get(_META):
        click.echo(f"{time.monotonic() - BEGUN:9.3f} s  {text}", err=True)


def log_stages(seconds: Mapping[str, float]) -> None:
    """What each stage took of the processors: of all threads and processes together."""
    whole = sum(seconds.values())
    for stage, spent in seconds.items():
        log(f"  {stage:12s}{spent:8.3f} s of the processor{100.0 * spent / whole:6.1f} %")
