"""Step files: their items, and their text with one row a step.

docs/interfaces.md describes the format.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.native import digits

MOTORS = "ABZE"
VERSION = 1
NAMES = b"tick,motor,direction\n"
KEY_BITS = 3  # of a key: two for the motor, one for the direction


@dataclass(frozen=True, slots=True)
class Header:
    """Header of a step file. matrix (2, 2): mm of belts A, B per mm of x, y."""

    version: str
    printer: str
    settings: str
    clock_hz: float
    step_mm: tuple[float, ...]
    matrix: Array

    def text(self) -> bytes:
        (ax, ay), (bx, by) = self.matrix.tolist()
        text = (
            f"#hframe-post steps,{VERSION}\n"
            f"#version,{self.version}\n#printer,{self.printer}\n#settings,{self.settings}\n"
            f"#clock_hz,{self.clock_hz!r}\n#motors,{','.join(MOTORS)}\n"
            f"#step_mm,{','.join(map(repr, self.step_mm))}\n"
            f"#belt,A,{ax:g},{ay:g}\n#belt,B,{bx:g},{by:g}\n"
        )
        return text.encode() + NAMES


@dataclass(frozen=True, slots=True)
class Note:
    """A line that is not motion; it comes after the steps of its tick."""

    tick: int
    handling: str
    text: bytes

    def line(self) -> bytes:
        return b"%d,%s,%s\n" % (self.tick, self.handling.encode(), self.text)


EVENTS_HEADER = b"#hframe-post events,%d\ntick,handling,text\n" % VERSION


@dataclass(frozen=True, slots=True)
class Start:
    """Position of the motors, (4,) whole steps from the origin, before the next steps."""

    tick: int
    position: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Stepped:
    """Steps in order of tick, tick·8 + motor·2 + (1 if forwards), (n,), and notes among them."""

    keys: Integers
    notes: tuple[Note, ...] = ()


@dataclass(frozen=True, slots=True)
class End:
    """The end of the print."""

    tick: int


Item = Start | Stepped | End


class StepFileWriter:
    """Writer of a step file's text. rows, lines: of steps and of all lines, written so far."""

    def __init__(self, header: Header) -> None:
        self._header = header
        self.rows, self.lines = 0, 0

    def write(self, items: Iterable[Item]) -> Iterator[bytes | Note]:
        """Yield the text, and the notes after the steps of their tick, for a file of events."""
        head = self._header.text()
        self.lines += head.count(b"\n")
        yield head
        for item in items:
            if isinstance(item, Stepped):
                yield from self._stepped(item)
                continue
            self.lines += 1
            if isinstance(item, End):
                yield b"#end,%d,%d\n" % (item.tick, self.rows)
            else:
                yield b"#start,%d,%d,%d,%d,%d\n" % (item.tick, *item.position)

    def _stepped(self, item: Stepped) -> Iterator[bytes | Note]:
        cuts = [int(np.searchsorted(item.keys, note.tick + 1 << KEY_BITS)) for note in item.notes]
        for start, stop, note in zip([0, *cuts], [*cuts, None], [*item.notes, None], strict=True):
            if len(keys := item.keys[start:stop]):
                self.rows += len(keys)
                self.lines += len(keys)
                yield _text(keys)
            if note is not None:
                yield note


def inlined(pieces: Iterable[bytes | Note]) -> Iterator[bytes]:
    """Yield one text, in which notes are lines."""
    for piece in pieces:
        yield b"#event," + piece.line() if isinstance(piece, Note) else piece


def _text(keys: Integers) -> bytes:
    """Return a row for each step."""
    return digits.rows([digits.whole(keys >> KEY_BITS), _tails()[keys & 7]])


@cache
def _tails() -> digits.Bytes:
    """Return the end of a row for each motor and direction, (8, 5)."""
    rows = "".join(f",{motor},{forwards}\n" for motor in MOTORS for forwards in (0, 1))
    return np.frombuffer(rows.encode(), dtype=np.uint8).reshape(-1, 5)
