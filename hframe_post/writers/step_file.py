"""Step files: their items, their text with one row a step or one row a tick, and its reader.

docs/formats.md describes the format.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO

import numpy as np

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.errors import StepFileError
from hframe_post.native import digits
from hframe_post.writers.files import decompressing

MOTORS = "ABZE"
VERSION = 1
NAMES = {"steps": b"tick,motor,direction\n", "step-bits": b"tick,steps,directions\n"}
KEY_BITS = 3  # of a key: two for the motor, one for the direction
BYTES_AT_ONCE = 1 << 20
NUMBER = rb"(-?\d{1,18}(?:\.\d{1,18})?(?:e[+-]?\d{1,3})?)"
START_LINE = re.compile(rb"#start,(\d{1,18})" + rb",(-?\d{1,18})" * len(MOTORS))
END_LINE = re.compile(rb"#end,(\d{1,18}),(\d{1,18})")
HEADER = re.compile(
    rb"#hframe-post (steps|step-bits),(\d+)\n"
    rb"#version,([^\n]*)\n#printer,([^\n]*)\n#settings,([^\n]*)\n"
    rb"#clock_hz," + NUMBER + rb"\n#motors,A,B,Z,E\n"
    rb"#step_mm" + (rb"," + NUMBER) * len(MOTORS) + rb"\n"
    rb"#belt,A," + NUMBER + rb"," + NUMBER + rb"\n#belt,B," + NUMBER + rb"," + NUMBER + rb"\n"
)
VALUES = {"steps": ("ABZE", "01"), "step-bits": ("0123456789abcdef",) * 2}


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
        (ax, ay), (bx, by) = self.matrix.tolist()
        text = (
            f"#hframe-post {self.kind},{VERSION}\n"
            f"#version,{self.version}\n#printer,{self.printer}\n#settings,{self.settings}\n"
            f"#clock_hz,{self.clock_hz!r}\n#motors,{','.join(MOTORS)}\n"
            f"#step_mm,{','.join(map(repr, self.step_mm))}\n"
            f"#belt,A,{ax:g},{ay:g}\n#belt,B,{bx:g},{by:g}\n"
        )
        return text.encode() + NAMES[self.kind]


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
            if isinstance(item, End):
                yield b"#end,%d,%d\n" % (item.tick, self.rows)
            else:
                yield b"#start,%d,%d,%d,%d,%d\n" % (item.tick, *item.position)

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


@dataclass(frozen=True, slots=True)
class Positions:
    """Positions of the motors after each of n rows, in order of tick.

    tick (n,); position (n, 4): whole steps of A, B, z, e; xyze (n, 4): mm. Of rows with equal
    ticks the last counts. fresh: the first row is a start position, not a step.
    """

    tick: Integers
    position: Integers
    xyze: Array
    fresh: bool


@dataclass(frozen=True, slots=True)
class StepFile:
    """A step file on disk. Iterating yields its ``Positions`` in blocks, in constant memory."""

    path: Path
    header: Header
    head: int  # bytes before the first row

    def __iter__(self) -> Iterator[Positions]:
        """Yield the positions. Raises StepFileError, which names the line, and OSError."""
        reader = _StepReader(self)
        with decompressing(self.path) as file:
            _piece(file, self.head, self.path)
            rest = b""
            while piece := _piece(file, BYTES_AT_ONCE, self.path):
                lines, newline, rest = (rest + piece).rpartition(b"\n")
                yield from reader.lines(lines + newline)
                if len(rest) > BYTES_AT_ONCE:
                    raise StepFileError("a line does not end", self.path)
        reader.check_complete(rest)


def read(path: str | Path) -> StepFile:
    """Read a step file; .gz is unpacked. Raises StepFileError if it is none, and OSError."""
    path = Path(path)
    with decompressing(path) as file:
        text = _piece(file, BYTES_AT_ONCE, path)
    match = HEADER.match(text)
    if match is None:
        raise StepFileError("this is not a step file", path, 1)
    kind, version, printer, settings = (match[k].decode("utf-8", "replace") for k in (1, 3, 4, 5))
    if match[2] != b"%d" % VERSION:
        cause = f"version {match[2].decode()} of the format is unknown: install a newer hframe-post"
        raise StepFileError(cause, path, 1)
    if not text.startswith(NAMES[kind], match.end()):
        raise StepFileError("the names of the columns are missing", path, text.count(b"\n"))
    clock, *numbers = (float(match[k]) for k in range(6, 15))
    steps, matrix = tuple(numbers[:4]), np.reshape(numbers[4:], (2, 2))
    if min(clock, *steps) <= 0.0 or np.linalg.det(matrix) == 0.0:
        raise StepFileError("clock, step lengths or belts are invalid", path, 1)
    header = Header(kind, version, printer, settings, clock, steps, matrix)
    return StepFile(path, header, match.end() + len(NAMES[kind]))


def _piece(file: IO[bytes], size: int, path: Path) -> bytes:
    try:
        return file.read(size)
    except OSError:
        raise
    except Exception as error:  # each way of packing has its own exceptions
        raise StepFileError(f"cannot be unpacked: {error}", path) from None


class _StepReader:
    """Rows → positions, with the last tick and position remembered."""

    def __init__(self, file: StepFile) -> None:
        header = file.header
        self._path, self._bits = file.path, header.kind == "step-bits"
        self._tables = [_table(names) for names in VALUES[header.kind]]
        self._step_mm = np.array(header.step_mm)
        self._to_xy = np.linalg.inv(header.matrix)
        self._line = header.text().count(b"\n") + 1  # of the next line
        self._position: Integers | None = None
        self._tick = self._rows = 0
        self._ended = False

    def lines(self, text: bytes) -> Iterator[Positions]:
        at = 0
        while at < len(text):
            if self._ended:
                raise self._error("lines after the end")
            if text.startswith(b"#", at):
                stop = text.index(b"\n", at)
                yield from self._directive(text[at:stop])
                self._line += 1
                at = stop + 1
            else:
                stop = text.find(b"\n#", at) + 1 or len(text)
                yield self._rows_of(text[at:stop])
                at = stop

    def check_complete(self, rest: bytes) -> None:
        if rest or not self._ended:
            raise self._error("the file is incomplete")

    def _directive(self, line: bytes) -> Iterator[Positions]:
        if match := START_LINE.fullmatch(line):
            tick, *position = (int(number) for number in match.groups())
            if tick < self._tick:
                raise self._error("ticks go backwards")
            self._tick, self._position = tick, np.array(position)
            yield self._positions(np.array([tick]), self._position[None], fresh=True)
        elif match := END_LINE.fullmatch(line):
            if int(match[2]) != self._rows:
                raise self._error(f"{self._rows} rows, but {int(match[2])} were written")
            self._ended = True
        elif not line.startswith(b"#event,"):
            raise self._error("unknown kind of line")

    def _rows_of(self, text: bytes) -> Positions:
        if self._position is None:
            raise self._error("steps from an unknown position")
        tick, first, second, good = _numbers(text, *self._tables)
        good &= np.diff(tick, prepend=self._tick) >= self._bits * (np.arange(len(tick)) > 0)
        if not good.all():
            self._line += int(np.argmin(good))
            raise self._error("this is not a row of steps, or its tick goes backwards")
        change = np.zeros((len(tick), len(MOTORS)), dtype=np.int64)
        if self._bits:
            for motor in range(len(MOTORS)):
                change[:, motor] = (first >> motor & 1) * (2 * (second >> motor & 1) - 1)
        else:
            change[np.arange(len(tick)), first] = 2 * second - 1
        position = self._position + np.cumsum(change, axis=0)
        self._tick, self._position = int(tick[-1]), position[-1]
        self._rows += len(tick)
        self._line += len(tick)
        return self._positions(tick, position, fresh=False)

    def _positions(self, tick: Integers, position: Integers, fresh: bool) -> Positions:
        xyze = position * self._step_mm
        xyze[:, :2] = xyze[:, :2] @ self._to_xy.T
        return Positions(tick, position, xyze, fresh)

    def _error(self, cause: str) -> StepFileError:
        return StepFileError(cause, self._path, self._line)


def _table(names: str) -> Integers:
    """Return the value of each byte; −1: it has none."""
    table = np.full(256, -1)
    table[list(names.encode())] = np.arange(len(names))
    return table


def _numbers(
    text: bytes, first: Integers, second: Integers
) -> tuple[Integers, Integers, Integers, Flags]:
    """Return the three columns of rows ``123,A,1``, (n,) each, and whether each is valid."""
    byte = np.frombuffer(text, dtype=np.uint8)
    end = np.flatnonzero(byte == ord("\n"))
    width = np.diff(end, prepend=-1) - len(",A,1\n")
    good = (width >= 1) & (width <= 18)  # more digits would not fit into 64 bits
    comma_1, name, comma_2, value = (byte[np.maximum(end - k, 0)] for k in (4, 3, 2, 1))
    good &= (comma_1 == ord(",")) & (comma_2 == ord(","))
    one, other = first[name], second[value]
    good &= (one >= 0) & (other >= 0)
    tick = np.zeros(len(end), dtype=np.int64)
    for place in range(int(width[good].max(initial=0))):
        digit = byte[np.maximum(end - 5 - place, 0)].astype(np.int64) - ord("0")
        within = place < width
        good &= ~within | ((digit >= 0) & (digit <= 9))
        tick += np.where(within & good, digit * 10**place, 0)
    return tick, one, other, good
