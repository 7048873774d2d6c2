"""What is kept for converted files: the sliced ones, to convert these again, and their pages.

A kept file's name is a hash of the converted one: its size, its time and its first bytes. So it is
found after a restart, under a new name and for a copy that keeps its time, and never for another
file in the same place. Its page has the same name. What belongs to no file any more is removed; if
too much is kept or the disk is nearly full, the oldest page, then the oldest sliced file.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

from .disk import FOLDER, FailureError, GoneError, gcode_files, place, stamp, write

STAMP = r"; processed by hframe-post (?P<version>[^\s,]+)"
SETTINGS = re.compile(
    rb"^; processed by hframe-post .*, settings (?P<settings>[0-9a-f]+)\r?$", re.M
)
HEAD_BYTES = 4096  # bytes of a converted file that tell it from others
COMMENT_BYTES = 1 << 20  # bytes in which Moonraker looks for the stamp; previews may precede it
SUFFIX, PAGE_SUFFIX = ".original", ".html"
FREE_SHARE = 0.05  # of the disk, that kept files leave
PAGE_BYTES = 100_000_000  # bytes: with less, the converted file may not fit next to it


def settings_of(path: Path) -> str:
    """Return the hash of the settings that a file was converted with; empty: it was not."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        if found := SETTINGS.search(file.read(COMMENT_BYTES)):
            return found["settings"].decode()
    return ""


class Originals:
    """The kept files in FOLDER. most: bytes that may be kept."""

    def __init__(self, gcodes: Path, most: int) -> None:
        self._gcodes, self._folder, self._most = gcodes, gcodes / FOLDER, most

    def of(self, converted: Path) -> Path:
        """Return the place of a converted file's original. Raises OSError."""
        with converted.open("rb") as file:
            head, found = file.read(HEAD_BYTES), os.fstat(file.fileno())
        key = hashlib.sha256(b"%d %d " % (found.st_size, found.st_mtime_ns) + head)
        return self._folder / f"{key.hexdigest()}{SUFFIX}"

    def page_of(self, converted: Path) -> Path:
        """Return the place of a converted file's page. Raises OSError."""
        return self.of(converted).with_suffix(PAGE_SUFFIX)

    def replace(self, path: Path, new: Path, original: Path) -> None:
        """Put a converted file in its place and keep its original, whatever interrupts it.

        Its page is kept, too, if it is next to ``new``.
        """
        kept = self.of(new)
        with contextlib.suppress(FileNotFoundError):
            new.with_suffix(PAGE_SUFFIX).replace(kept.with_suffix(PAGE_SUFFIX))
        with contextlib.suppress(OSError):  # a file system without links
            os.link(original, kept)
        place(new, path)
        if not kept.exists():
            original.replace(kept)
        elif original.suffix != SUFFIX:  # else it may be a copy's, too
            original.unlink()
        with contextlib.suppress(OSError):  # such as of a file that is deleted meanwhile
            os.utime(kept)
            self.tidy()

    def stale(self, settings: str) -> Iterator[Path]:
        """Yield the files that were converted with other settings and can be converted again."""
        for path in gcode_files(self._gcodes):
            if settings_of(path) not in ("", settings) and self.of(path).exists():
                yield path

    def tidy(self) -> None:
        """Remove kept files without their converted file, and those beyond the limits.

        Nothing else may convert meanwhile.
        """
        for left in (*self._folder.glob("*.converted"), *self._folder.glob("*.new")):
            left.unlink(missing_ok=True)  # by a process that was killed
        kept = self._kept()
        if kept:
            needed = {self.of(path) for path in gcode_files(self._gcodes) if settings_of(path)}
            for path in kept:
                if path.with_suffix(SUFFIX) not in needed:
                    path.unlink()
        self.make_room()

    def make_room(self) -> None:
        """Remove kept files, as long as they are too large or the disk is too full."""
        # pages first, which another conversion makes again
        kept = sorted(self._kept(), key=lambda path: (path.suffix == SUFFIX, path.stat().st_mtime))
        size = sum(path.stat().st_size for path in kept)
        for path in kept:
            if size <= self._most and not self._is_disk_full():
                return
            size -= path.stat().st_size
            path.unlink()

    def has_room(self) -> bool:
        """Return whether there is room for a page next to what is converted."""
        return self._most > 0 and not self._is_disk_full(PAGE_BYTES)

    def _kept(self) -> list[Path]:
        return [path for path in self._folder.iterdir() if path.suffix in (SUFFIX, PAGE_SUFFIX)]

    def _is_disk_full(self, least: int = 0) -> bool:
        disk = shutil.disk_usage(self._folder)
        return disk.free < max(FREE_SHARE * disk.total, least)


# ----------------------------------------------------------------------
# An upload: its place while it is converted, and lines that Klipper refuses to print.
#
# If Moonraker is stopped in mid-conversion, it finds these lines when it starts again and converts
# the file then, also under another name. A file that cannot be converted gets such a line, with the
# reason, in front: no interface can print it. If the user deletes the file, its conversion stops.

# Klipper's answer to an unknown name is an error that shows it, and an error ends the print
REFUSAL = 'RESTORE_GCODE_STATE NAME="hframe-post: '
KEPT = b"; hframe-post keeps the sliced file as "  # the line below a refusal that stands alone
KEPT_NAME = re.compile(rb"[0-9a-f]{64}-[0-9a-f]{16}\.sliced")
MAX_REFUSAL_BYTES = 1 << 16  # bytes of a refusal that stands alone
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

        made: the converted file, next to which the slicer's is kept; None: it is the slicer's.
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
        refusal, comment, *more = [*file.read(MAX_REFUSAL_BYTES).split(b"\n"), b""]
        name = comment.removeprefix(KEPT)
        if refusal.startswith(REFUSAL.encode()) and comment.startswith(KEPT) and not any(more):
            return name.decode() if KEPT_NAME.fullmatch(name) else ""
    return ""


def refusals(gcodes: Path, kept: str) -> Iterator[Path]:
    """Yield the files that stand for a kept file: more than one if one was copied."""
    for path in gcode_files(gcodes):
        with contextlib.suppress(OSError):
            if path.stat().st_size < MAX_REFUSAL_BYTES and kept_for(path) == kept:
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
