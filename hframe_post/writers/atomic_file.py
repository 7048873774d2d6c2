"""The output file: whole or not there at all, and lines that are known only at the end."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO

from hframe_post.writers.gcode import DeferredLine, Output
from hframe_post.writers.print_time import told_anew

ROOM = 24  # bytes beyond a deferred line's present length


class OutputFile:
    """A context manager: what is written appears at ``path`` on success, else nothing does.

    path None: standard output, once everything has been written.
    """

    def __init__(self, path: Path | None, stdout: IO[bytes]) -> None:
        self._path = path.resolve() if path is not None else None
        self._stdout = stdout
        self._deferred: list[tuple[int, int, DeferredLine]] = []
        self._file: IO[bytes] | None = None

    def __enter__(self) -> OutputFile:
        folder = self._path.parent if self._path is not None else None
        self._file = tempfile.NamedTemporaryFile(
            dir=folder, prefix=".hframe-post-", suffix=".tmp", delete=False
        )
        return self

    @property
    def file(self) -> IO[bytes]:
        """Where to write."""
        assert self._file is not None
        return self._file

    def write(self, output: Iterable[Output], duration: Callable[[], float]) -> None:
        """Writes it all. duration: the print's time (s), asked when the output is used up."""
        file = self.file
        for piece in output:
            if isinstance(piece, DeferredLine):
                size = len(piece.line) + ROOM
                self._deferred.append((file.tell(), size, piece))
                file.write(b" " * size + b"\n")
            else:
                file.write(piece)
        total = duration()
        for offset, size, deferred in self._deferred:
            file.seek(offset)
            file.write(told_anew(deferred, total).ljust(size)[:size])

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        name = Path(self.file.name)
        try:
            self.file.close()
            if kind is not None:
                return
            if self._path is None:
                with name.open("rb") as whole:
                    shutil.copyfileobj(whole, self._stdout)
                self._stdout.flush()
            else:
                _copy_mode(self._path, name)
                os.replace(name, self._path)
        finally:
            name.unlink(missing_ok=True)


def _copy_mode(old: Path, new: Path) -> None:
    """A replaced file keeps its permissions; a new one gets the usual."""
    if old.exists():
        shutil.copymode(old, new)
    else:
        mask = os.umask(0)
        os.umask(mask)
        new.chmod(0o666 & ~mask)
