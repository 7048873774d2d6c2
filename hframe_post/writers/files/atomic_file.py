"""Output files of a command: all of them appear complete, or none does.

A file is written next to its target under a temporary name and replaces the target at the
end. A target that is no regular file (a device, a pipe, standard output) is written to directly,
once everything is known.
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
    """Context manager whose files appear once all of them are written.

    reads: files that the command reads, which no output may replace.
    """

    def __init__(self, reads: Iterable[Path] = ()) -> None:
        self._taken: list[object] = []
        for path in reads:
            with contextlib.suppress(OSError):  # a missing file cannot be replaced
                self._taken.append(identity(path))
        self._replaced: list[_Replaced] = []
        self._through: list[tuple[IO[bytes], Through]] = []
        self._sources: list[tuple[Path, Stamp]] = []

    def __enter__(self) -> Outputs:
        return self

    def open(self, path: Path | None, instead_of: Path | None = None) -> IO[bytes]:
        """Return a file to write, read and seek. None: standard output.

        instead_of: the one among the files read that this may replace. Raises HframeError or
        OSError if the target cannot be written.
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
        replaceable = (
            identity(instead_of) if instead_of is not None and instead_of.exists() else None
        )
        if this in self._taken and this != replaceable:
            raise HframeError(
                f"{path} is already read or written by this command: name another file"
            )
        self._taken.append(this)
        check_replaceable(target, path)
        with named(path):
            replaced = _Replaced(target, *create(target.parent))
        self._replaced.append(replaced)
        return replaced.file

    def watch(self, source: IO[bytes], path: Path) -> None:
        """Let no file appear if this source is changed before the end."""
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
        """Replace the targets, after all that can fail: full disks, closed pipes, new sources."""
        for replaced in self._replaced:
            with named(replaced.target):
                replaced.finish()
        for path, before in self._sources:
            if stamp(os.stat(path)) != before:
                raise HframeError(
                    f"{path} was changed while it was read; nothing was written: run the command "
                    "again"
                )
        for file, opened in self._through:
            file.seek(0)
            with opened() as target:
                shutil.copyfileobj(file, target)
        with undisturbed():
            for replaced in self._replaced:
                replaced.appear()


@dataclass(frozen=True, slots=True)
class _Replaced:
    """A file that will replace ``target``, and its temporary name."""

    target: Path
    file: IO[bytes]
    name: Path

    def finish(self) -> None:
        self.file.flush()
        like(self.target, self.file)
        os.fsync(self.file.fileno())

    def appear(self) -> None:
        if os.name != "posix":  # where an open file keeps its name
            self.file.close()
        os.replace(self.name, self.target)

    def discard(self) -> None:
        remove(self.name)  # before its lock goes
        with contextlib.suppress(OSError):  # a full disk was reported already
            self.file.close()
