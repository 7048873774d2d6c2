"""Files of the component: where they are, and how they are written, compared and waited for."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

NAME = "hframe_post"
FOLDER = ".hframe_post"  # in the folder of G-code, so that moving a file copies nothing
SETTLED_S = 1.0  # s without a change, after which a file is complete


class FailureError(Exception):
    """The reason why a file is not converted."""


class BeyondError(FailureError):
    """A conversion needs more memory or time than it may take."""


class GoneError(Exception):
    """The user has deleted, renamed or replaced the file."""


def write(path: Path, head: bytes, rest: IO[bytes] | None = None) -> None:
    """Write a file that is complete even if the power fails right after its renaming."""
    with path.open("wb") as file:
        file.write(head)
        if rest is not None:
            shutil.copyfileobj(rest, file)
        file.flush()
        os.fsync(file.fileno())


def place(new: Path, path: Path) -> None:
    """Move a file to ``path``, where it is complete as soon as it is there."""
    try:
        new.replace(path)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        near, made = path.with_name(f".{new.stem}"), new.stat()
        try:
            with new.open("rb") as file:
                write(near, b"", file)
            os.utime(near, ns=(made.st_atime_ns, made.st_mtime_ns))  # by which it is known
            near.replace(path)
        finally:
            near.unlink(missing_ok=True)
        new.unlink()


def stamp(path: Path) -> tuple[int, ...]:
    """Return numbers that change if a file is replaced or written to; empty if it is gone."""
    try:
        found = path.lstat()
    except OSError:
        return ()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def settle(path: Path) -> None:
    """Wait until nobody writes to a file any more."""
    before: tuple[int, ...] | None = None
    while (now := stamp(path)) != before:
        before = now
        time.sleep(SETTLED_S)


def gcode_files(gcodes: Path) -> Iterator[Path]:
    """Yield all files in the folder of G-code but those in FOLDER, following links once."""
    seen = set()
    for folder, folders, files in os.walk(gcodes, followlinks=True):
        here = os.path.realpath(folder)
        folders[:] = [] if here in seen else [name for name in folders if name != FOLDER]
        seen.add(here)
        yield from (Path(folder, name) for name in files)


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Wait until no other conversion runs, such as one of a Moonraker that was killed."""
    import fcntl  # which Windows has not, where setup reads this folder

    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def cause(error: Exception) -> str:
    """Return what is wrong, where, and what to do."""
    if isinstance(error, OSError) and error.strerror:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        where = Path(error.filename).parent if full and error.filename else error.filename
        advice = ". Make room there, then upload the file again" if full else ""
        return ": ".join(str(part) for part in (where, error.strerror) if part) + advice
    return str(error).removeprefix("Error: ")
