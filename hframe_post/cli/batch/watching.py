"""A folder whose files are converted as they land there."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import click

from hframe_post.cli.batch.job import jobs_of
from hframe_post.cli.batch.running import Place, run

SUFFIXES = (".gcode", ".gco", ".g")  # of what is converted in a folder
SETTLED = 2.0  # s without change, after which an upload is taken to be complete


def watch_folder(
    watched: Path, folder: Path, place: Callable[[], Place], first_line: bytes, quiet: bool
) -> None:
    """Converts what is there, what changes and what comes. Ends with Ctrl-C."""
    try:
        from watchfiles import watch
    except ImportError:
        raise click.UsageError(
            "--watch needs the package watchfiles: pip install 'hframe-post[watch]'"
        ) from None

    if not quiet:
        click.echo(f"watching {watched}, Ctrl-C ends", err=True)
    failed: dict[Path, tuple[int, int]] = {}  # not tried again until they change
    for _ in watch(watched, recursive=False, yield_on_timeout=True, rust_timeout=1000,
                   raise_interrupt=False):  # fmt: skip
        found = [path for path in sorted(watched.iterdir()) if failed.get(path) != _version(path)]
        found = [path for path in found if _is_gcode(path) and _is_complete(path)]
        pending = [job for job in jobs_of(found, folder, first_line) if not job.finished]
        for job in run(pending, place(), quiet) if pending else ():
            if job.state == "failed":
                failed[job.source] = _version(job.source)


def _version(path: Path) -> tuple[int, int]:
    try:
        told = path.stat()
    except OSError:  # taken away in the meantime
        return 0, 0
    return told.st_mtime_ns, told.st_size


def _is_gcode(path: Path) -> bool:
    named = path.suffix.lower() in SUFFIXES and not path.name.startswith(".")
    return named and path.is_file()


def _is_complete(path: Path) -> bool:
    """Whether nobody has written there for a while."""
    return time.time() - _version(path)[0] / 1e9 >= SETTLED
