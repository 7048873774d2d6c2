"""Samples and steps as tables: of numbers every millisecond, and of when each motor steps.

Tables become CSV or .npz as they grow, in constant memory.
"""

from __future__ import annotations

import io
import shutil
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path
from typing import IO

import numpy as np

from hframe_post.arrays import TS, Array, E, Integers, Z
from hframe_post.model.plant import Plant, Response
from hframe_post.native import digits
from hframe_post.stream.chunks import batches, stretches, with_neighbours
from hframe_post.stream.types import Samples

# Path, command, lift and filament, prediction. s, mm, rad.
COLUMNS = ("t", "x_d", "y_d", "x_dm", "y_dm", "z", "e", "theta", "x", "y")
DECIMALS = (3, 6, 6, 6, 6, 6, 6, 9, 6, 6)
ROWS_AT_ONCE = 1 << 14


def tabulate(chunks: Iterable[Samples], strategy: str, plant: Plant) -> Iterator[Array]:
    """Yield tables (n, len(COLUMNS)) of a strategy's command. t: the end of a sample's millisecond.

    The prediction starts from rest after each release of the machine.
    """
    for stretch in stretches(chunks):
        filled = (chunk for chunk in batches(stretch, ROWS_AT_ONCE) if len(chunk))
        if (first := next(filled, None)) is None:
            continue
        loaded = plant.loaded(plant.load(float(first.xyze[0, E])))
        response, early = Response(loaded, first.xyze[0, :Z]), loaded.ahead
        for chunk, wide, _ in with_neighbours(chain([first], filled), 0, loaded.ahead):
            command, following = chunk.commands[strategy], wide.commands[strategy]
            missing = len(command) + loaded.ahead - len(following)  # at the end, where it rests
            following = np.concatenate([following, np.repeat(following[-1:], missing, axis=0)])
            response.run(following[:early])
            early = 0
            nozzle, theta = response.motion(following[loaded.ahead :])
            t = np.arange(chunk.first + 1, chunk.end + 1) * TS
            yield np.column_stack([t, chunk.xyze[:, :Z], command, chunk.xyze[:, Z:], theta, nozzle])


def as_csv(tables: Iterable[Array]) -> Iterator[bytes]:
    """Yield the tables as CSV, with the columns' names first."""
    yield ",".join(COLUMNS).encode() + b"\n"
    for table in tables:
        comma, newline = digits.column(b",", len(table)), digits.column(b"\n", len(table))
        columns = [
            part
            for values, decimals in zip(table.T, DECIMALS, strict=True)
            for part in (digits.fixed(values, decimals), comma)
        ]
        yield digits.rows([*columns[:-1], newline])


def write_npz(
    file: IO[bytes], tables: Iterable[Array], names: tuple[str, ...], stamp: str, folder: Path
) -> None:
    """Write one array a column, as ``np.savez`` does, and the text ``stamp``.

    Equal input gives equal bytes. A column's length is known only at its end, so columns wait in
    temporary files in ``folder``.
    """
    with ExitStack() as stack:
        spools = [stack.enter_context(tempfile.TemporaryFile(dir=folder)) for _ in names]
        rows = 0
        for table in tables:
            rows += len(table)
            for spool, column in zip(spools, table.T, strict=True):
                spool.write(column.astype("<f8").tobytes())
        archive = stack.enter_context(zipfile.ZipFile(file, "w", allowZip64=True))
        for name, spool in zip(names, spools, strict=True):
            spool.seek(0)
            header = {"descr": "<f8", "fortran_order": False, "shape": (rows,)}
            with _member(archive, name) as member:
                np.lib.format.write_array_header_1_0(member, header)
                shutil.copyfileobj(spool, member)
        with _member(archive, "stamp") as member:
            text = io.BytesIO()
            np.save(text, np.array(stamp))
            member.write(text.getvalue())


def _member(archive: zipfile.ZipFile, name: str) -> IO[bytes]:
    no_date = (1980, 1, 1, 0, 0, 0)  # the earliest in a zip file
    return archive.open(zipfile.ZipInfo(f"{name}.npy", no_date), "w", force_zip64=True)


# ----------------------------------------------------------------------
# Step files: their items, and their text with one row a step.
#
# docs/interfaces.md describes the format.

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
