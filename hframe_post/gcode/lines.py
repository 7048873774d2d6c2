"""The lines of a file, numbered, of which some can be seen before their turn."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO

from hframe_post.errors import GcodeError
from hframe_post.gcode.binary import MAGIC, as_text
from hframe_post.gcode.lexer import Line

LONGEST = 1 << 20  # bytes of a line; no slicer writes nearly as much, no firmware reads it
AHEAD = 4000  # lines to be seen before their turn
AHEAD_BYTES = 1 << 20
BLOCK_BYTES = 1 << 18  # that are read at once


def lines_of(file: IO[bytes]) -> Iterator[bytes]:
    """The lines of a file, text or binary; of one that is too long, only as much as shows it."""
    first = file.readline(LONGEST + 2)
    if first.startswith(MAGIC):
        with as_text(first, file) as text:
            yield from lines_of(text)
    elif first:
        yield first
        yield from iter(lambda: file.readline(LONGEST + 2), b"")


def reread(path: Path) -> Callable[[], Iterator[bytes]]:
    """What gives the lines of a file, from the first, each time that it is called."""

    def lines() -> Iterator[bytes]:
        with path.open("rb") as file:
            yield from lines_of(file)

    return lines


class Lines:
    """Iterates over ``Line``s. Raises GcodeError where this cannot be G-code.

    cr_ends_lines: whether a carriage return inside a line ends it: what follows is then a
    line of the same number. ``number``: of the last line. The source is read some lines ahead;
    an error of its own is raised where it would have been without that.
    """

    def __init__(self, source: Iterable[bytes], cr_ends_lines: bool = False) -> None:
        self._source = iter(source)
        self._cr_ends_lines = cr_ends_lines
        self._block, self._next = list[bytes](), 0  # lines read, of which so many are taken
        self._text: bytes | None = None  # of the block
        self._offset = 0  # where the next of them begins there
        self._read = 0  # lines
        self._error: Exception | None = None  # of the source, behind the block
        self._held: deque[Line] = deque()
        self.number = 0

    def __iter__(self) -> Iterator[Line]:
        held = self._held
        while held or self._hold():
            line = held.popleft()
            self.number = line.number
            yield line

    def ahead(self) -> Iterator[Line]:
        """The lines that come next, without taking them: a bounded number of them."""
        size, k = 0, 0
        while k < AHEAD and size < AHEAD_BYTES:
            if k >= len(self._held) and not self._hold():
                return
            yield self._held[k]
            size += len(self._held[k].text)
            k += 1

    def text(self) -> tuple[bytes, int]:
        """Some of what comes next: a text that ends with a line feed, from an offset on.

        Empty where there is none, or what comes next has been seen ``ahead``.
        """
        if self._held or not (self._next < len(self._block) or self._fill()):
            return b"", 0
        if self._text is None:
            ended = self._block if self._block[-1].endswith(b"\n") else self._block[:-1]
            text = b"".join(ended)
            self._text = text if text.count(b"\n") == len(ended) else b""
        return (self._text, self._offset) if self._offset < len(self._text) else (b"", 0)

    def skip(self, lines: int, size: int) -> None:
        """So many lines and bytes of ``text`` have been taken."""
        self._next, self._offset = self._next + lines, self._offset + size
        self._read += lines
        self.number = self._read

    def _hold(self) -> bool:
        """One more line of the source is held; False after the last."""
        if not (self._next < len(self._block) or self._fill()):
            return False
        raw = self._block[self._next]
        self._next, self._offset = self._next + 1, self._offset + len(raw)
        self._read += 1
        self._held.extend(self._parts(self._read, raw))
        return True

    def _fill(self) -> bool:
        """The next block; False after the last."""
        if self._error is not None:
            raise self._error
        self._block, self._next, self._text, self._offset, size = [], 0, None, 0, 0
        try:
            for raw in self._source:
                self._block.append(raw)
                size += len(raw)
                if size > BLOCK_BYTES:
                    break
        except Exception as error:
            self._error = error
        if not self._block and self._error is not None:
            raise self._error
        return bool(self._block)

    def _parts(self, number: int, raw: bytes) -> Iterable[Line]:
        """A line of the file: one, but for carriage returns."""
        text = raw.removesuffix(b"\n")
        if len(text) > LONGEST:
            raise GcodeError(f"a line of more than {LONGEST} characters", number, text[:80])
        if number == 1:
            text = _first(text)
        if self._cr_ends_lines and b"\r" in text[:-1]:
            return [Line(number, part) for part in text.removesuffix(b"\r").split(b"\r")]
        return (Line(number, text),)


def _first(text: bytes) -> bytes:
    if text.startswith(MAGIC):
        raise GcodeError("this is binary G-code, not its text")
    return text.removeprefix(b"\xef\xbb\xbf")
