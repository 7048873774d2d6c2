"""Temporary files, removed even when a process is stopped.

The process that writes one holds a lock on it. One without a lock was left by a killed process,
and is removed by the next one.
"""

from __future__ import annotations

import contextlib
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import IO

try:
    import fcntl
except ImportError:  # not on Windows, where an open file cannot be removed either
    fcntl = None  # type: ignore[assignment]

NAME = re.compile(r"\.hframe-post-[0-9a-f]{16}\.tmp")

_unfinished: set[Path] = set()  # names that must not outlive this process
_appearing = False


def give_up() -> bool:
    """Remove this process's temporary files; safe in a signal handler.

    Returns False, and removes nothing, while files are replacing their targets.
    """
    if _appearing:
        return False
    for name in tuple(_unfinished):
        with contextlib.suppress(OSError):
            name.unlink(missing_ok=True)
    return True


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Keep ``give_up`` from removing files."""
    global _appearing
    _appearing = True
    try:
        yield
    finally:
        _appearing = False


def create_temporary(folder: Path) -> tuple[IO[bytes], Path]:
    """Return a new, locked file in this folder, and its name. Removes stale ones."""
    _remove_stale(folder)
    while True:
        name = folder / f".hframe-post-{os.urandom(8).hex()}.tmp"
        _unfinished.add(name)  # first: a signal may come at any time
        try:
            descriptor = os.open(name, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        except OSError:
            _unfinished.discard(name)
            raise
        file = open(descriptor, "w+b")  # noqa: SIM115  closed with its target
        if fcntl is None:
            return file, name
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        if os.fstat(descriptor).st_nlink:  # no process removed it as stale before it was locked
            return file, name
        _unfinished.discard(name)
        file.close()


def remove_temporary(name: Path) -> None:
    """Remove one of these files, if it was not renamed meanwhile."""
    name.unlink(missing_ok=True)
    _unfinished.discard(name)


def _remove_stale(folder: Path) -> None:
    """Remove temporary files of processes that have ended."""
    if fcntl is None:
        return
    with os.scandir(folder) as entries:
        names = [entry.path for entry in entries if NAME.fullmatch(entry.name)]
    for name in names:
        with contextlib.suppress(OSError):  # in use, another user's, or gone
            descriptor = os.open(name, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                status = os.fstat(descriptor)
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid():
                    os.unlink(name)
            finally:
                os.close(descriptor)
