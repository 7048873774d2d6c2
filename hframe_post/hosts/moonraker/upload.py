"""An upload: its place while it is converted, and lines that Klipper refuses to print.

If Moonraker is stopped in mid-conversion, it finds these lines when it starts again and converts
the file then, also under another name. A file that cannot be converted gets such a line, with the
reason, in front: no interface can print it. If the user deletes the file, its conversion stops.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import secrets
from collections.abc import Iterator
from pathlib import Path

from .disk import FOLDER, FailureError, GoneError, gcode_files, place, stamp, write
from .originals import Originals

# Klipper's answer to an unknown name is an error that shows it, and an error ends the print
REFUSAL = 'RESTORE_GCODE_STATE NAME="hframe-post: '
KEPT = b"; hframe-post keeps the sliced file as "  # the line below a refusal that stands alone
KEPT_NAME = re.compile(rb"[0-9a-f]{64}-[0-9a-f]{16}\.sliced")
LONGEST = 1 << 16  # bytes of a refusal that stands alone
CONVERTING = "not converted yet: try again later, or upload the file again"
INTERRUPTED = "its conversion was interrupted: upload it again"


class Upload:
    """A file of G-code at ``path``, and its place ``work`` while it is converted."""

    def __init__(self, path: Path, gcodes: Path) -> None:
        relative = os.fsencode(os.path.relpath(path, gcodes))
        self.path, self._gcodes = path, gcodes
        self._hash = hashlib.sha256(relative).hexdigest()
        # never the same name twice, so that a refusal can only mean the file that it stands for
        self.work = gcodes / FOLDER / f"{self._hash}-{secrets.token_hex(8)}.sliced"
        self._refusal: tuple[int, ...] = ()

    def take(self) -> None:
        """Let ``work`` be the slicer's file and put a refusal in its place."""
        kept = kept_for(self.path)
        with self.path.open("rb") as file:
            if kept:
                self._find(self.work.with_name(kept))
            elif not file.readline().startswith(REFUSAL.encode()):
                self._keep()
            elif file.peek(1):
                with self._new() as new:
                    write(new, b"", file)
                    new.replace(self.work)
            else:
                raise FailureError(INTERRUPTED)
        self.refuse(CONVERTING)
        self._forget()

    def _find(self, kept: Path) -> None:
        """Let ``work`` be the file that the refusal names."""
        if not kept.exists():
            raise FailureError(INTERRUPTED)
        if all(path == self.path for path in refusals(self._gcodes, kept.name)):
            self.work = kept
            return
        with self._new() as new, kept.open("rb") as file:  # somebody copied the refusal
            write(new, b"", file)
            new.replace(self.work)

    def _keep(self) -> None:
        try:
            os.link(self.path, self.work)  # moved away, the file would be reported as deleted
            if self.path.is_symlink() or self.work.stat().st_nlink > 2:
                raise OSError("the file has other names, which keep it")
        except OSError:  # also on another file system
            with self._new() as new, self.path.open("rb") as file:
                write(new, b"", file)
                new.replace(self.work)

    def _forget(self) -> None:
        """Remove what earlier uploads of this name left, unless a refusal still names it."""
        for old in self.work.parent.glob(f"{self._hash}-*"):
            if old != self.work and not any(refusals(self._gcodes, old.name)):
                old.unlink(missing_ok=True)

    def refuse(self, reason: str, in_front: bool = False) -> None:
        """Replace the file by a line that Klipper refuses, or put that line in front of it."""
        said = re.sub(r'["\\#*;<>]+', "'", " ".join(reason.split()))
        line = f'{REFUSAL}{said}"\n'.encode(errors="replace")
        with self._new() as new:
            if in_front:
                with self.work.open("rb") as work:
                    write(new, line, work)
            else:
                write(new, line + KEPT + self.work.name.encode() + b"\n")
            place(new, self.path)
        self._refusal = stamp(self.path)
        if in_front:
            self.work.unlink()

    def give_back(self, made: Path | None, originals: Originals) -> None:
        """Put the converted file where the slicer's was. Raises GoneError.

        made: the converted file, beside which the slicer's is kept; None: it is the slicer's.
        """
        if self.is_gone():
            raise GoneError
        if made is None:
            place(self.work, self.path)
        else:
            originals.replace(self.path, made, self.work)

    def is_gone(self) -> bool:
        """Return whether anything but the refusal is in the file's place."""
        return bool(self._refusal) and stamp(self.path) != self._refusal

    def let_go(self) -> str:
        """Remove ``work`` if nobody needs it; return what became of the file."""
        if stamp(self.path):
            self.work.unlink(missing_ok=True)
            return "replaced"
        if any(refusals(self._gcodes, self.work.name)):
            return "renamed"
        self.work.unlink(missing_ok=True)
        return "deleted"

    @contextlib.contextmanager
    def _new(self) -> Iterator[Path]:
        new = self.work.with_suffix(".new")
        try:
            yield new
        finally:
            new.unlink(missing_ok=True)


def kept_for(path: Path) -> str:
    """Return the name of the kept file that a refusal in its place names; empty: none."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        refusal, comment, *more = [*file.read(LONGEST).split(b"\n"), b""]
        name = comment.removeprefix(KEPT)
        if refusal.startswith(REFUSAL.encode()) and comment.startswith(KEPT) and not any(more):
            return name.decode() if KEPT_NAME.fullmatch(name) else ""
    return ""


def refusals(gcodes: Path, kept: str) -> Iterator[Path]:
    """Yield the files that stand for a kept file: more than one if one was copied."""
    for path in gcode_files(gcodes):
        with contextlib.suppress(OSError):
            if path.stat().st_size < LONGEST and kept_for(path) == kept:
                yield path


def refuse(upload: Upload, reason: str) -> None:
    """Make sure that a file is not printed. Nothing is lost: on a full disk ``work`` stays."""
    if not upload.work.exists():  # it could not even be read
        return
    for in_front in (True, False):  # where the file does not fit a second time, a line may
        with contextlib.suppress(OSError):
            return upload.refuse(reason, in_front)
    with contextlib.suppress(OSError):
        upload.path.unlink()
