"""Output files of a command: all of them appear complete, or none does. Packed ones, too.

A file is written next to its target under a temporary name and replaces the target at the
end. A target that is not a regular file (a device, a pipe, standard output) is written to directly,
once everything is known.
"""

from __future__ import annotations

import contextlib
import errno
import gzip
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import IO, cast

from hframe_post.errors import HframeError
from hframe_post.writers.temporary import create_temporary, remove_temporary, undisturbed

FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", None))  # a quota, not on Windows
DESCRIPTOR = re.compile(r"/dev/std(?P<name>out|err)|/(?:dev|proc/self)/fd/(?P<number>\d+)")

Stamp = tuple[int, int, int, int]  # device, file, size and time of change
Through = Callable[[], AbstractContextManager[IO[bytes]]]


class Outputs:
    """Context manager whose files appear once all of them are written.

    reads: files that the command reads, which no output may replace. appeared: whether the files
    are there, complete.
    """

    def __init__(self, reads: Iterable[Path] = ()) -> None:
        self.appeared = False
        self._taken: list[object] = []
        for path in reads:
            with contextlib.suppress(OSError):  # a missing file cannot be replaced
                self._taken.append(_identity(path))
        self._replacing: list[tuple[Path, IO[bytes], Path]] = []  # target, new file, its name
        self._through: list[tuple[IO[bytes], Through]] = []
        self._sources: list[tuple[Path, Stamp]] = []

    def __enter__(self) -> Outputs:
        return self

    def open(self, path: Path | None, instead_of: Path | None = None) -> IO[bytes]:
        """Return a file to write, read and seek. None: standard output.

        instead_of: the one among the files read that this may replace. Raises HframeError or
        OSError if the target cannot be written.
        """
        through = _written_through(path)
        if through is not None:
            file: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  closed at the end
            self._through.append((file, through))
            return file
        assert path is not None
        target = Path(os.path.realpath(path))
        with _named(path):
            this = _identity(target)
        source = _identity(instead_of) if instead_of and instead_of.exists() else None
        if this in self._taken and this != source:
            raise HframeError(
                f"{path} is already read or written by this command: name another file"
            )
        self._taken.append(this)
        _check_replaceable(target, path)
        with _named(path):
            file, name = create_temporary(target.parent)
        self._replacing.append((target, file, name))
        return file

    def watch(self, path: Path) -> None:
        """Let no file appear if this source is changed from now on."""
        if path.is_file():
            self._sources.append((path, _stamp(os.stat(path))))

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        try:
            if kind is None:
                self._appear()
            elif isinstance(error, OSError) and error.errno in FULL and error.filename is None:
                self._name_full_disk(error)
        finally:
            for file, _ in self._through:
                file.close()
            for _, file, name in self._replacing:
                remove_temporary(name)  # before its lock goes
                with contextlib.suppress(OSError):  # a full disk was reported already
                    file.close()

    def _name_full_disk(self, error: OSError) -> None:
        """Raise the error again, with the folder of the file that takes no more."""
        waiting = Path(tempfile.gettempdir())  # of what goes to standard output or a device
        files = [(target.parent, file) for target, file, _ in self._replacing]
        files += [(waiting, file) for file, _ in self._through]
        for folder, file in files:
            with _named(folder):
                file.flush()
        if files:
            with _named(files[0][0]):
                raise error

    def _appear(self) -> None:
        """Replace the targets, after all that can fail: full disks, closed pipes, new sources."""
        for target, file, _ in self._replacing:
            with _named(target.parent):
                file.flush()
                os.fsync(file.fileno())
            with _named(target):
                _make_like(target, file)
        for path, before in self._sources:
            if _stamp(os.stat(path)) != before:
                raise HframeError(
                    f"{path} was changed while it was read; nothing was written: run the command "
                    "again"
                )
        for file, opened in self._through:
            file.seek(0)
            with opened() as sink:
                shutil.copyfileobj(file, sink)
        with undisturbed():
            for target, file, name in self._replacing:
                if os.name != "posix":  # where an open file keeps its name
                    file.close()
                os.replace(name, target)
        self.appeared = True


def _written_through(path: Path | None) -> Through | None:
    """Return how to open a path that is not a regular file; None for a regular or a new file."""
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


@contextmanager
def _standard_output() -> Iterator[IO[bytes]]:
    yield sys.stdout.buffer
    sys.stdout.buffer.flush()


def _descriptor(path: Path) -> int | None:
    """Return the descriptor that a path names, maybe through links. Raises OSError."""
    for _ in range(40):  # links, as many as the system follows
        if found := DESCRIPTOR.fullmatch(str(path)):
            number = int(found["number"] or {"out": 1, "err": 2}[found["name"]])
            with _named(path):
                os.fstat(number)
            return number
        if not path.is_symlink():
            break
        path = path.parent / path.readlink()
    return None


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Make an OSError name the path that the user asked for."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def _identity(path: Path) -> tuple[object, ...]:
    """Return a key that is equal for every name of one file, even a new one. Raises OSError."""
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
    if not target.exists():
        return
    status = target.stat()
    writable = status.st_mode & (stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH)
    if not writable or not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, "is write-protected", str(path))
    if status.st_nlink > 1:
        raise HframeError(
            f"{path} has {status.st_nlink} names (hard links), and only one of them would be "
            "replaced: write to a new file with -o"
        )


def _make_like(old: Path, new: IO[bytes]) -> None:
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


@contextmanager
def compressing(file: IO[bytes], suffix: str) -> Iterator[IO[bytes]]:
    """Yield a file that writes to ``file``, compressed if the suffix is .gz.

    Equal input gives equal bytes: no name, no date.
    """
    if suffix != ".gz":
        yield file
        return
    with gzip.GzipFile("", "wb", 6, file, mtime=0) as packed:
        yield cast(IO[bytes], packed)
