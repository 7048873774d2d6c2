"""Step files: their items, and their text with one row a step or one row a tick.

docs/formats.md describes the format; ``reader`` is the inverse.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.writers.stream import digits

MOTORS = "ABZE"
VERSION = 1
NAMES = {"steps": b"tick,motor,direction\n", "step-bits": b"tick,steps,directions\n"}
KEY_BITS = 3  # of a key: two for the motor, one for the direction


@dataclass(frozen=True, slots=True)
class Header:
    """Header of a step file. matrix (2, 2): mm of belts A, B per mm of x, y."""

    kind: str
    version: str
    printer: str
    settings: str
    clock_hz: float
    step_mm: tuple[float, ...]
    matrix: Array

    def text(self) -> bytes:
        rows = zip(MOTORS, self.matrix.tolist(), strict=False)
        lines = [
            f"#hframe-post {self.kind},{VERSION}",
            f"#version,{self.version}",
            f"#printer,{self.printer}",
            f"#settings,{self.settings}",
            f"#clock_hz,{self.clock_hz!r}",
            f"#motors,{','.join(MOTORS)}",
            f"#step_mm,{','.join(map(repr, self.step_mm))}",
            *(f"#belt,{motor},{x:g},{y:g}" for motor, (x, y) in rows),
        ]
        return "".join(line + "\n" for line in lines).encode() + NAMES[self.kind]


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
        self._render = _Ticks() if header.kind == "step-bits" else _steps
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
            yield (
                b"#end,%d,%d\n" % (item.tick, self.rows)
                if isinstance(item, End)
                else b"#start,%d,%d,%d,%d,%d\n" % (item.tick, *item.position)
            )

    def _stepped(self, item: Stepped) -> Iterator[bytes | Note]:
        cuts = [int(np.searchsorted(item.keys, note.tick + 1 << KEY_BITS)) for note in item.notes]
        for start, stop, note in zip([0, *cuts], [*cuts, None], [*item.notes, None], strict=True):
            if len(keys := item.keys[start:stop]):
                count, text = self._render(keys)
                self.rows += count
                self.lines += count
                yield text
            if note is not None:
                yield note


def inlined(pieces: Iterable[bytes | Note]) -> Iterator[bytes]:
    """Yield one text, in which notes are lines."""
    for piece in pieces:
        yield b"#event," + piece.line() if isinstance(piece, Note) else piece


def _steps(keys: Integers) -> tuple[int, bytes]:
    """Return the number of rows and their text, a row for each step."""
    return len(keys), digits.rows([digits.whole(keys >> KEY_BITS), _tails("ABZE", 2)[keys & 7]])


class _Ticks:
    """Text with a row for each tick with a step. Remembers each motor's last direction."""

    def __init__(self) -> None:
        self._headings = 0

    def __call__(self, keys: Integers) -> tuple[int, bytes]:
        tick = keys >> KEY_BITS
        first = np.flatnonzero(np.diff(tick, prepend=-1))
        stepped = np.bitwise_or.reduceat(1 << (keys >> 1 & 3), first)
        forwards = np.bitwise_or.reduceat((keys & 1) << (keys >> 1 & 3), first)
        headings = np.zeros_like(forwards)
        for motor in range(len(MOTORS)):
            bit = 1 << motor
            steps = np.flatnonzero(stepped & bit)
            kept = np.diff(steps, prepend=0, append=len(first))  # rows until the next step
            known = np.concatenate([[self._headings & bit], forwards[steps] & bit])
            headings |= np.repeat(known, kept)
        self._headings = int(headings[-1])
        tails = _tails("0123456789abcdef", 16)[stepped * 16 + headings]
        return len(first), digits.rows([digits.whole(tick[first]), tails])


@cache
def _tails(names: str, values: int) -> digits.Bytes:
    """Return the end of a row for each name and value, (names·values, 5)."""
    rows = "".join(f",{name},{value:x}\n" for name in names for value in range(values))
    return np.frombuffer(rows.encode(), dtype=np.uint8).reshape(-1, 5)
