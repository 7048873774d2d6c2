"""A folder whose G-code files are converted as they arrive."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from hframe_post.batch.job import Job, jobs_for
from hframe_post.errors import HframeError

SUFFIXES = (".gcode", ".gco", ".g")
UPLOAD_PAUSE = 2.0  # s without a change after which an upload counts as complete


def watch_folder(watched: Path, folder: Path, first_line: bytes) -> Iterator[list[Job]]:
    """Yield lists of files to convert, until interrupted.

    The caller converts each list in place before it asks for the next: a file that failed is not
    tried again until it changes. Raises HframeError where the package watchfiles is missing.
    """
    try:
        from watchfiles import watch
    except ImportError:
        raise HframeError(
            "--watch needs the package watchfiles: pip install 'hframe-post[watch]'"
        ) from None

    failed: dict[Path, tuple[int, int]] = {}
    for _ in watch(watched, recursive=False, yield_on_timeout=True, rust_timeout=1000,
                   raise_interrupt=False):  # fmt: skip
        found = [
            path
            for path in sorted(watched.iterdir())
            if _is_complete_gcode(path) and failed.get(path) != _version(path)
        ]
        jobs = [job for job in jobs_for(found, folder, first_line) if not job.finished]
        if jobs:
            yield jobs
        failed |= {job.source: _version(job.source) for job in jobs if job.state == "failed"}


def _is_complete_gcode(path: Path) -> bool:
    if path.suffix.lower() not in SUFFIXES or path.name.startswith(".") or not path.is_file():
        return False
    return time.time() - _version(path)[0] / 1e9 >= UPLOAD_PAUSE


def _version(path: Path) -> tuple[int, int]:
    try:
        status = path.stat()
    except OSError:  # deleted in the meantime
        return 0, 0
    return status.st_mtime_ns, status.st_size
