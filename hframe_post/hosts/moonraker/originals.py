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
import shutil
from collections.abc import Iterator
from pathlib import Path

from .disk import FOLDER, gcode_files, place

STAMP = r"; processed by hframe-post (?P<version>[^\s,]+)"
SETTINGS = re.compile(
    rb"^; processed by hframe-post .*, settings (?P<settings>[0-9a-f]+)\r?$", re.M
)
HEAD = 4096  # bytes of a converted file that tell it from others
COMMENTS = 1 << 20  # bytes in which Moonraker looks for the stamp; previews may precede it
SUFFIX, PAGE_SUFFIX = ".original", ".html"
LEAST_FREE = 0.05  # of the disk, that kept files leave
FREE_FOR_PAGE = 100_000_000  # bytes: with less, the converted file may not fit next to it


def settings_of(path: Path) -> str:
    """Return the hash of the settings that a file was converted with; empty: it was not."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        if found := SETTINGS.search(file.read(COMMENTS)):
            return found["settings"].decode()
    return ""


class Originals:
    """The kept files in FOLDER. most: bytes that may be kept."""

    def __init__(self, gcodes: Path, most: int) -> None:
        self._gcodes, self._folder, self._most = gcodes, gcodes / FOLDER, most

    def of(self, converted: Path) -> Path:
        """Return the place of a converted file's original. Raises OSError."""
        with converted.open("rb") as file:
            head, found = file.read(HEAD), os.fstat(file.fileno())
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
        return self._most > 0 and not self._is_disk_full(FREE_FOR_PAGE)

    def _kept(self) -> list[Path]:
        return [path for path in self._folder.iterdir() if path.suffix in (SUFFIX, PAGE_SUFFIX)]

    def _is_disk_full(self, least: int = 0) -> bool:
        disk = shutil.disk_usage(self._folder)
        return disk.free < max(LEAST_FREE * disk.total, least)
