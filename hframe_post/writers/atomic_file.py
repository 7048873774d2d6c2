"""Output files: all of a command's appear whole, or none does; the rest is written through.

A file is written beside its target under a temporary name and takes the target's place at the
end. What is no regular file (a device, a pipe, standard output) is written through, once
everything is known. The process that writes a temporary file holds a lock on it, so one
without a lock was left by a process that was killed, and is removed.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from hframe_post.errors import HframeError

try:
    import fcntl
except ImportError:  # not on Windows, where an open file cannot be removed either
    fcntl = None  # type: ignore[assignment]

TEMPORARY = re.compile(r"\.hframe-post-[0-9a-f]{16}\.tmp")
DESCRIPTOR = re.compile(r"/dev/std(?P<name>out|err)|/(?:dev|proc/self)/fd/(?P<number>\d+)")
PERMISSIONS = 0o777  # without set-user-ID and the like
MOST_LINKS = 40  # from one name to the next, as the system allows

Stamp = tuple[int, int, int, int]  # device, file, size and time of change
Through = Callable[[], AbstractContextManager[IO[bytes]]]


class Outputs:
    """A context manager: what was written to its files appears once all of it is written.

    reads: files that the command reads, which no output may replace. Raises HframeError or
    OSError when a target is opened that cannot be written as it should be.
    """

    def __init__(self, reads: Iterable[Path] = ()) -> None:
        self._taken: list[object] = []
        for path in reads:
            with contextlib.suppress(OSError):  # not there: nothing to replace
                self._taken.append(_identity(path))
        self._replaced: list[_Replaced] = []
        self._through: list[tuple[IO[bytes], Through]] = []
        self._sources: list[tuple[IO[bytes], Path, Stamp]] = []

    def __enter__(self) -> Outputs:
        return self

    def open(self, path: Path | None, instead_of: Path | None = None) -> IO[bytes]:
        """A file to write, which can be read and sought, too. None: standard output.

        instead_of: the one among the files read that this may replace.
        """
        through = _written_through(path)
        if through is not None:
            file: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  closed at the end
            self._through.append((file, through))
            return file
        assert path is not None
        target = Path(os.path.realpath(path))
        with _named(path):
            identity = _identity(target)
        own = _identity(instead_of) if instead_of is not None and instead_of.exists() else None
        if identity in self._taken and identity != own:
            raise HframeError(f"{path}: this file is read, or written, by the same command")
        self._taken.append(identity)
        _check_replaceable(target, path)
        with _named(path):
            replaced = _Replaced(target, *_temporary(target.parent))
        self._replaced.append(replaced)
        return replaced.file

    def watch(self, source: IO[bytes], path: Path) -> None:
        """Nothing appears if this file, which is being read, was changed before the end."""
        if path.is_file():
            self._sources.append((source, path, _stamp(os.fstat(source.fileno()))))

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        try:
            if kind is None:
                self._appear()
        finally:
            for file, _ in self._through:
                file.close()
            for replaced in self._replaced:
                replaced.discard()

    def _appear(self) -> None:
        """What can fail comes first: full disks, closed pipes, changed sources."""
        for replaced in self._replaced:
            with _named(replaced.target):
                replaced.finish()
        for source, path, before in self._sources:
            if _stamp(os.fstat(source.fileno())) != before or _stamp(os.stat(path)) != before:
                raise HframeError(f"{path}: was changed while it was read; nothing was written")
        for file, opened in self._through:
            file.seek(0)
            with opened() as target:
                shutil.copyfileobj(file, target)
        with _undisturbed():
            for replaced in self._replaced:
                replaced.appear()


@dataclass(frozen=True, slots=True)
class _Replaced:
    """A file that takes the place of ``target``, and its temporary name till then."""

    target: Path
    file: IO[bytes]
    name: Path

    def finish(self) -> None:
        """All of it on the disk, with the owner and the permissions of what it replaces."""
        self.file.flush()
        _like(self.target, self.file)
        os.fsync(self.file.fileno())

    def appear(self) -> None:
        if fcntl is None:
            self.file.close()
        os.replace(self.name, self.target)

    def discard(self) -> None:
        self.name.unlink(missing_ok=True)  # before its lock goes
        _unfinished.discard(self.name)
        with contextlib.suppress(OSError):  # a full disk was told of already
            self.file.close()


# ---------------------------------------------------------------------- targets


def _written_through(path: Path | None) -> Through | None:
    """How to open what is no regular file; None for what is, or is not there yet."""
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
    """Of a path that names, maybe through links, a file that is open already. Raises OSError."""
    for _ in range(MOST_LINKS):
        if found := DESCRIPTOR.fullmatch(str(path)):
            number = int(found["number"] or {"out": 1, "err": 2}[found["name"]])
            with _named(path):
                os.fstat(number)
            return number
        if not path.is_symlink():
            break
        path = path.parent / path.readlink()
    return None


@contextlib.contextmanager
def _named(path: Path) -> Iterator[None]:
    """An OSError tells of the path that was asked for, whatever was tried for it."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def _identity(path: Path) -> tuple[object, ...]:
    """Equal for every name of one file, there or not. Raises OSError where it cannot be."""
    try:
        status = os.stat(path)
    except OSError:
        path = Path(os.path.realpath(path))
        parent = os.stat(path.parent)
        return parent.st_dev, parent.st_ino, path.name
    return status.st_dev, status.st_ino


def _stamp(status: os.stat_result) -> Stamp:
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def _check_replaceable(target: Path, path: Path) -> None:
    """Raises OSError or HframeError where a file of the same kind cannot take the place."""
    if not target.exists():
        return
    status = target.stat()
    writable = any(status.st_mode & bit for bit in (stat.S_IWUSR, stat.S_IWGRP, stat.S_IWOTH))
    if not writable or not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, "is write-protected", str(path))
    if status.st_nlink > 1:
        raise HframeError(
            f"{path}: has {status.st_nlink} names (hard links), of which only one would be "
            "replaced: write to a new file with -o"
        )


def _like(old: Path, new: IO[bytes]) -> None:
    """A replaced file keeps owner and permissions; a new one gets the usual."""
    if os.name != "posix":
        return
    if not old.exists():
        mask = os.umask(0)
        os.umask(mask)
        os.fchmod(new.fileno(), 0o666 & ~mask)
        return
    status, own = old.stat(), os.fstat(new.fileno())
    if (status.st_uid, status.st_gid) != (own.st_uid, own.st_gid):
        try:
            os.fchown(new.fileno(), status.st_uid, status.st_gid)
        except OSError:
            cause = "belongs to others, and would not any more: write to a new file with -o"
            raise HframeError(f"{old}: {cause}") from None
    os.fchmod(new.fileno(), status.st_mode & PERMISSIONS)


# ---------------------------------------------------------------------- temporary files

_unfinished: set[Path] = set()  # names that must not outlive this process
_appearing = False


def give_up() -> bool:
    """Removes this process's temporary files: for a signal handler, which may come at any time.

    False: files are appearing at this moment; let them.
    """
    if _appearing:
        return False
    for name in tuple(_unfinished):
        with contextlib.suppress(OSError):
            name.unlink(missing_ok=True)
    return True


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    global _appearing
    _appearing = True
    try:
        yield
    finally:
        _appearing = False


def _temporary(folder: Path) -> tuple[IO[bytes], Path]:
    """A new, locked file in this folder, and its name. Stale ones are removed."""
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
        if os.fstat(descriptor).st_nlink:  # nobody took it for a stale one before it was locked
            return file, name
        _unfinished.discard(name)
        file.close()


def _remove_stale(folder: Path) -> None:
    """Removes temporary files of processes that are no more."""
    if fcntl is None:
        return
    with os.scandir(folder) as entries:
        names = [entry.path for entry in entries if TEMPORARY.fullmatch(entry.name)]
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
