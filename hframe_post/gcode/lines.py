"""The lines of a file, numbered, of which some can be seen before their turn."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import IO

from hframe_post.errors import GcodeError
from hframe_post.gcode.binary import MAGIC, as_text
from hframe_post.gcode.lexer import Line

LONGEST = 1 << 20  # bytes of a line; no slicer writes nearly as much, no firmware reads it
AHEAD = 4000  # lines to be seen before their turn
AHEAD_BYTES = 1 << 20


def lines_of(file: IO[bytes]) -> Iterator[bytes]:
    """The lines of a file, text or binary; of one that is too long, only as much as shows it."""
    first = file.readline(LONGEST + 2)
    if first.startswith(MAGIC):
        with as_text(first, file) as text:
            yield from lines_of(text)
    elif first:
        yield first
        yield from iter(lambda: file.readline(LONGEST + 2), b"")


class Lines:
    """Iterates over ``Line``s. Raises GcodeError where this cannot be G-code.

    cr_ends_lines: whether a carriage return inside a line ends it: what follows is then a
    line of the same number.
    """

    def __init__(self, source: Iterable[bytes], cr_ends_lines: bool = False) -> None:
        self._source = enumerate(source, 1)
        self._cr_ends_lines = cr_ends_lines
        self._held: deque[Line] = deque()
        self.number = 0  # of the last line

    def __iter__(self) -> Iterator[Line]:
        held = self._held
        for number, raw in self._source:
            self.number = number
            yield from self._parts(number, raw)
            while held:
                line = held.popleft()
                self.number = line.number
                yield line

    def ahead(self) -> Iterator[Line]:
        """The lines that come next, without taking them: a bounded number of them."""
        size, k = 0, 0
        while k < AHEAD and size < AHEAD_BYTES:
            if k >= len(self._held):
                following = next(self._source, None)
                if following is None:
                    return
                self._held.extend(self._parts(*following))
            yield self._held[k]
            size += len(self._held[k].text)
            k += 1

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
