"""Output files: all of a command's appear whole, or none does; the rest is written through.

A file is written beside its target under a temporary name and takes the target's place at the
end. What is no regular file (a device, a pipe, standard output) is written through, once
everything is known.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from hframe_post.errors import HframeError
from hframe_post.writers.files.targets import (
    Stamp,
    Through,
    check_replaceable,
    identity,
    like,
    named,
    stamp,
    written_through,
)
from hframe_post.writers.files.temporary import create, remove, undisturbed


class Outputs:
    """A context manager: what was written to its files appears once all of it is written.

    reads: files that the command reads, which no output may replace. Raises HframeError or
    OSError when a target is opened that cannot be written as it should be.
    """

    def __init__(self, reads: Iterable[Path] = ()) -> None:
        self._taken: list[object] = []
        for path in reads:
            with contextlib.suppress(OSError):  # not there: nothing to replace
                self._taken.append(identity(path))
        self._replaced: list[_Replaced] = []
        self._through: list[tuple[IO[bytes], Through]] = []
        self._sources: list[tuple[Path, Stamp]] = []

    def __enter__(self) -> Outputs:
        return self

    def open(self, path: Path | None, instead_of: Path | None = None) -> IO[bytes]:
        """A file to write, which can be read and sought, too. None: standard output.

        instead_of: the one among the files read that this may replace.
        """
        through = written_through(path)
        if through is not None:
            file: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  closed at the end
            self._through.append((file, through))
            return file
        assert path is not None
        target = Path(os.path.realpath(path))
        with named(path):
            this = identity(target)
        own = identity(instead_of) if instead_of is not None and instead_of.exists() else None
        if this in self._taken and this != own:
            raise HframeError(f"{path}: this file is read, or written, by the same command")
        self._taken.append(this)
        check_replaceable(target, path)
        with named(path):
            replaced = _Replaced(target, *create(target.parent))
        self._replaced.append(replaced)
        return replaced.file

    def watch(self, source: IO[bytes], path: Path) -> None:
        """Nothing appears if this file, which is being read, was changed before the end."""
        if path.is_file():
            self._sources.append((path, stamp(os.fstat(source.fileno()))))

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
            with named(replaced.target):
                replaced.finish()
        for path, before in self._sources:
            if stamp(os.stat(path)) != before:
                raise HframeError(f"{path}: was changed while it was read; nothing was written")
        for file, opened in self._through:
            file.seek(0)
            with opened() as target:
                shutil.copyfileobj(file, target)
        with undisturbed():
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
        like(self.target, self.file)
        os.fsync(self.file.fileno())

    def appear(self) -> None:
        if os.name != "posix":  # where an open file keeps its name
            self.file.close()
        os.replace(self.name, self.target)

    def discard(self) -> None:
        remove(self.name)  # before its lock goes
        with contextlib.suppress(OSError):  # a full disk was told of already
            self.file.close()
