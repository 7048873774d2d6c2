"""Targets of output: a new file, a file to replace, or a device, pipe or descriptor."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import IO

from hframe_post.errors import HframeError

DESCRIPTOR = re.compile(r"/dev/std(?P<name>out|err)|/(?:dev|proc/self)/fd/(?P<number>\d+)")

Stamp = tuple[int, int, int, int]  # device, file, size and time of change
Through = Callable[[], AbstractContextManager[IO[bytes]]]


def written_through(path: Path | None) -> Through | None:
    """Return how to open a path that is no regular file; None for a regular or a new file."""
    if path is None:
        if sys.stdout is None:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF), "standard output")
        return _standard_output
    if (descriptor := _descriptor(path)) is not None:
        # the same open file: what others write there stays, before and after
        return lambda: open(os.dup(descriptor), "wb")
    if not path.exists() or path.is_file():
        return None
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    return lambda: path.open("wb")


@contextlib.contextmanager
def _standard_output() -> Iterator[IO[bytes]]:
    yield sys.stdout.buffer
    sys.stdout.buffer.flush()


def _descriptor(path: Path) -> int | None:
    """Return the descriptor that a path names, maybe through links. Raises OSError."""
    for _ in range(40):  # links, as many as the system follows
        if found := DESCRIPTOR.fullmatch(str(path)):
            number = int(found["number"] or {"out": 1, "err": 2}[found["name"]])
            with named(path):
                os.fstat(number)
            return number
        if not path.is_symlink():
            break
        path = path.parent / path.readlink()
    return None


@contextlib.contextmanager
def named(path: Path) -> Iterator[None]:
    """Make an OSError name the path that the user asked for."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def identity(path: Path) -> tuple[object, ...]:
    """Return a key that is equal for every name of one file, even a new one. Raises OSError."""
    try:
        status = os.stat(path)
    except OSError:
        path = Path(os.path.realpath(path))
        parent = os.stat(path.parent)
        return parent.st_dev, parent.st_ino, path.name
    return status.st_dev, status.st_ino


def stamp(status: os.stat_result) -> Stamp:
    """Return what differs once a file has been changed or replaced."""
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def check_replaceable(target: Path, path: Path) -> None:
    """Raise OSError or HframeError if a new file cannot replace the target."""
    if not target.exists():
        return
    status = target.stat()
    writable = any(status.st_mode & bit for bit in (stat.S_IWUSR, stat.S_IWGRP, stat.S_IWOTH))
    if not writable or not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, "is write-protected", str(path))
    if status.st_nlink > 1:
        raise HframeError(
            f"{path} has {status.st_nlink} names (hard links), and only one of them would be "
            "replaced: write to a new file with -o"
        )


def like(old: Path, new: IO[bytes]) -> None:
    """Give a new file the owner and permissions of the old, or the usual ones."""
    if os.name != "posix":
        return
    if not old.exists():
        mask = os.umask(0)
        os.umask(mask)
        os.fchmod(new.fileno(), 0o666 & ~mask)
        return
    status, ours = old.stat(), os.fstat(new.fileno())
    if (status.st_uid, status.st_gid) != (ours.st_uid, ours.st_gid):
        try:
            os.fchown(new.fileno(), status.st_uid, status.st_gid)
        except OSError:
            cause = "belongs to another user, which a new file could not keep"
            raise HframeError(f"{old} {cause}: write to another file with -o") from None
    os.fchmod(new.fileno(), status.st_mode & 0o777)  # without set-user-ID and the like
