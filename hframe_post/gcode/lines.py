"""The numbered lines of a file, some of which can be seen before their turn."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from io import IOBase
from itertools import chain
from pathlib import Path
from typing import IO, cast

from hframe_post.errors import ArgumentError, GcodeError
from hframe_post.gcode.commands import Line

NOT_TEXT = {  # first bytes of files that are taken for G-code
    b"GCDE": "this is binary G-code: turn off 'Supports binary G-code' in the slicer's printer "
    "settings, and slice again",
    b"\x1f\x8b": "this file is compressed: unpack it first, with gunzip or 7-Zip",
    b"PK\x03\x04": "this is a ZIP archive, such as a project (.3mf): export the G-code from it",
    b"\xff\xfe": "this file is UTF-16, as PowerShell's > writes it: use -o instead of >",
    b"\xfe\xff": "this file is UTF-16: save it as UTF-8",
}
BINARY = ".bgcode"  # Prusa's, which is refused
NAMES = (".gcode", ".gco", ".g", BINARY)  # ends of the names of files of G-code
MAX_LINE_BYTES = 1 << 20  # no slicer writes nearly as much, and no firmware reads it
MAX_LINES_AHEAD = 4000  # that can be seen before their turn
MAX_BYTES_AHEAD = 1 << 20
BYTES_PER_READ = 1 << 18


def is_gcode_name(name: str) -> bool:
    """Return whether a file's name is one of G-code."""
    return name.lower().endswith(NAMES)


def lines_of(file: IO[bytes]) -> Iterator[bytes]:
    """Yield the lines of a file, many in a text; one that is too long is cut."""
    read, begun = getattr(file, "read1", file.read), b""
    while data := read(BYTES_PER_READ):
        begun += data
        if whole := begun.rfind(b"\n") + 1:
            yield begun[:whole]
            begun = begun[whole:]
        if len(begun) > MAX_LINE_BYTES:
            yield begun
            begun = b""
    if begun:
        yield begun


def _check_start(first: bytes) -> None:
    for start, cause in NOT_TEXT.items():
        if first.startswith(start):
            raise GcodeError(cause)


# a file of G-code, or its lines: texts of one line, or of several that end with a line feed
Source = str | Path | IO[bytes] | Iterable[bytes]


class Input:
    """G-code to read: a file, by its path or open, or lines.

    path: None if it is not known. once: whether it can be read only once. progress: called with the
    bytes of each text, the first time that all is read.
    """

    def __init__(self, source: Source, progress: Callable[[int], object] | None = None) -> None:
        self.path = Path(source) if isinstance(source, str | Path) else None
        self.once = isinstance(source, Iterator | IOBase)
        self._source, self._progress = source, progress

    def lines(self) -> Iterable[bytes]:
        """Return the lines, often many in a text."""
        lines, progress, self._progress = self._opened(), self._progress, None
        return lines if progress is None else _reported(lines, progress)

    def again(self) -> Iterable[bytes]:
        """Return the lines from the first. Raises ArgumentError if they can be read only once."""
        if self.once:
            raise ArgumentError("the source is read several times: give a path or a list of lines")
        return self._opened()

    def beginning(self, size: int) -> Iterator[bytes]:
        """Yield lines until they have a number of bytes. Raises ArgumentError as ``again``."""
        for text in self.again():
            yield text
            if (size := size - len(text)) <= 0:
                return

    def _opened(self) -> Iterable[bytes]:
        if self.path is not None:
            return _lines_in(self.path)
        source = cast(IO[bytes] | Iterable[bytes], self._source)
        return lines_of(cast(IO[bytes], source)) if isinstance(source, IOBase) else source


def _reported(lines: Iterable[bytes], progress: Callable[[int], object]) -> Iterator[bytes]:
    for line in lines:
        progress(len(line))
        yield line


def _lines_in(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        yield from lines_of(file)


class Lines:
    """Iterator over ``Line``s that can look ahead. Raises GcodeError where this cannot be G-code.

    source: texts of one line or several. cr_ends_lines: whether a carriage return inside a line
    ends it; what follows it is then another line of the same number. ``number``: that of the last
    line. The source is read in blocks; an error of its own is raised where it would have been
    without them.
    """

    def __init__(self, source: Iterable[bytes], cr_ends_lines: bool = False) -> None:
        self._source = iter(source)
        self._cr_ends_lines = cr_ends_lines
        self._text, self._offset = b"", 0  # lines, each with its line feed, and the next of them
        self._lines_read = 0
        self._error: Exception | None = None  # of the source, after the text
        self._queue: deque[Line] = deque()  # parts of the latest line
        self.number = 0

    def __iter__(self) -> Iterator[Line]:
        queue = self._queue
        while queue or self._read_line():
            line = queue.popleft()
            self.number = line.number
            yield line

    def ahead(self) -> Iterator[Line]:
        """Yield the next lines without taking them: a limited number of them."""
        seen = size = 0
        for line in chain(self._queue, self._unread()):
            yield line
            seen, size = seen + 1, size + len(line.text)
            if seen >= MAX_LINES_AHEAD or size >= MAX_BYTES_AHEAD:
                return

    def _unread(self) -> Iterator[Line]:
        number, size = self._lines_read, 0
        while raw := self._raw(size):
            number, size = number + 1, size + len(raw)
            yield from self._split(number, raw)

    def upcoming(self) -> tuple[bytes, int]:
        """Return a text that ends with a line feed, and the offset of the next line in it.

        The text is empty at the end of the file.
        """
        if self._queue or not (self._offset < len(self._text) or self._read_block()):
            return b"", 0
        return self._text, self._offset

    def skip(self, lines: int, size: int) -> None:
        self._offset += size
        self._lines_read += lines
        self.number = self._lines_read

    def _read_line(self) -> bool:
        """Put one more line of the source into the queue; return False after the last."""
        if not (raw := self._raw(0)):
            return False
        self._offset += len(raw)
        self._lines_read += 1
        self._queue.extend(self._split(self._lines_read, raw))
        return True

    def _raw(self, after: int) -> bytes:
        """Return the line that begins a number of bytes after the next; empty at the end."""
        if self._offset + after >= len(self._text) and not self._read_block():
            return b""
        begin = self._offset + after
        return self._text[begin : self._text.index(b"\n", begin) + 1]

    def _read_block(self) -> bool:
        """Read more of the source behind the lines left; return False if it has ended."""
        if self._error is not None:
            raise self._error
        new, size = list[bytes](), 0
        try:
            for raw in self._source:
                new.append(raw if raw.endswith(b"\n") else raw + b"\n")
                size += len(raw)
                if size > BYTES_PER_READ:
                    break
        except Exception as error:
            self._error = error
        if not new and self._error is not None:
            raise self._error
        if new:
            self._text, self._offset = b"".join([self._text[self._offset :], *new]), 0
        return bool(new)

    def _split(self, number: int, raw: bytes) -> Iterable[Line]:
        """Return the lines in a line of the file: one, except for carriage returns."""
        if number == 1:
            _check_start(raw)
        text = raw.removesuffix(b"\n")
        if len(text) > MAX_LINE_BYTES:
            raise GcodeError(f"a line of more than {MAX_LINE_BYTES} bytes", number, text[:80])
        if number == 1:
            text = text.removeprefix(b"\xef\xbb\xbf")
        if self._cr_ends_lines and b"\r" in text[:-1]:
            parts = text.removesuffix(b"\r").split(b"\r")
            if not all(part.lstrip()[:1] in (b"", b";") for part in parts):  # else a preview
                return [Line(number, part) for part in parts]
        return (Line(number, text),)
