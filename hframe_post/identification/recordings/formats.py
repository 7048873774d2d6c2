"""Formats of recordings and commands, and their packing.

Each format is a function that takes a file's path and content and the names in its first line, and
returns the recordings in it, or None if it is of another format. To support one more, add it to
``FORMATS``. A command is x and y every millisecond, as CSV. gzip, xz and zstd are recognized by a
file's first bytes; nothing may unpack to more than MAX_SIZE.
"""

from __future__ import annotations

import gzip
import io
import json
import lzma
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import zstandard

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.native import digits

MAX_SIZE = 1 << 28  # bytes, decompressed; two minutes of an ADXL345 are 20 MB
PIECE = 1 << 20  # bytes that are decompressed at once
BROKEN = (OSError, lzma.LZMAError, zlib.error, zstandard.ZstdError)
PACKED: dict[bytes, Callable[[BinaryIO], Any]] = {  # by a file's first bytes
    b"\x1f\x8b": lambda file: gzip.GzipFile(fileobj=file),
    b"\xfd7zXZ\0": lzma.LZMAFile,
    b"\x28\xb5\x2f\xfd": lambda file: zstandard.ZstdDecompressor().stream_reader(
        file, read_across_frames=True
    ),
}


def unpacked(path: Path) -> bytes:
    """Return a file's content, decompressed. Its first bytes show the format, not its name.

    Raises OSError, and IdentificationError if it is cut off, damaged or too large.
    """
    with path.open("rb") as file:
        head = file.peek(8)
        opener = next((each for magic, each in PACKED.items() if head.startswith(magic)), None)
        if opener is None:
            return _content(path, file)
        try:
            return _content(path, opener(file))
        except EOFError:
            raise IdentificationError(f"{path}: the compressed file is cut off") from None
        except BROKEN as error:
            raise IdentificationError(f"{path} cannot be decompressed: {error}") from None


def _content(path: Path, file: BinaryIO) -> bytes:
    parts, left = list[bytes](), MAX_SIZE
    while part := file.read(PIECE):
        left -= len(part)
        if left < 0:
            raise IdentificationError(
                f"{path}: the file is too large for a recording: unpacked it would have more than "
                f"{MAX_SIZE >> 20} MB. Give the recording of a single test"
            )
        parts.append(part)
    return b"".join(parts)


COMMAND = ["t", "x", "y"]  # as measure writes it
SHORTEST = 1000  # rows of a command


def command_csv(command: Array) -> Iterator[bytes]:
    """Yield a command (m, 2) as CSV: ``t,x,y`` in s and mm, one row a millisecond, t from 0."""
    yield ",".join(COMMAND).encode() + b"\n"
    t = np.arange(len(command)) * TS
    comma = digits.column(b",", len(command))
    at, x, y = (digits.fixed(values, 6) for values in (t, *command.T))
    yield digits.rows([at, comma, x, comma, y, digits.column(b"\n", len(command))])


def is_command(content: bytes) -> bool:
    """Return whether a file's content is the command of a motion."""
    return [name.lower() for name in _header(content)[0]] == COMMAND


def read_command(path: Path) -> Array:
    """Read x and y (m, 2) in mm from a command's CSV file.

    Raises OSError, and IdentificationError with the line and the cause.
    """
    content = unpacked(path)
    if not is_command(content):
        raise IdentificationError(
            f"{path} is not the command of a motion, whose first line is {','.join(COMMAND)}. Give "
            "the command first and the recording after it"
        )
    rows = _numbers(path, content, _header(content)[0])
    if len(rows) < SHORTEST:
        raise IdentificationError(f"{path}: too short: a command has {SHORTEST} rows at least")
    late = rows[:, 0] - rows[0, 0] - np.arange(len(rows)) * TS
    wrong = ~(np.isfinite(rows).all(axis=1) & (np.abs(late) <= 1e-6))
    if wrong.any():
        where = Table(rows, content).where(int(np.argmax(wrong)))
        raise IdentificationError(f"{path}: {where}: rows must be finite and 1 ms apart")
    return np.asarray(rows[:, 1:])


KLIPPER = ["#time", "accel_x", "accel_y", "accel_z"]
REPRAP = ["sample", "x", "y", "z"]
REPRAP_RATE = re.compile(rb"^\s*rate:?\s+(\d+(?:\.\d*)?)", re.IGNORECASE)
TIMES = ("time", "t", "timestamp")
ACCELERATIONS = (
    "accel_{}", "acceleration_{}", "acc_{}", "a{}", "a_{}", "{}_accel", "{}_acc", "{}",
)  # fmt: skip
UNIT = re.compile(r"[ _]*(?:\([^)]*\)|\[[^\]]*\]|_(?:g|mm/s2|m/s2|s))$")
MOST_SAMPLES = 1 << 22  # of a recording: 20 minutes of an ADXL345
LONGEST_HEAD = 1 << 12  # bytes of the line with the names of columns
LONGEST_NAME = 40  # characters of a column's name or a bad line, as errors show it


@dataclass(frozen=True, slots=True)
class Table:
    """One recording in a file: time (s) and three accelerations, (n, 4).

    Gravity shows their unit. text: the file, if it has lines, so that errors can name them.
    starts_with_command: whether the program that wrote the file began recording with the first
    sample of the command. name: of the recording, if the file names it.
    """

    values: Array
    text: bytes | None = None
    starts_with_command: bool = False
    name: str = ""

    def where(self, row: int) -> str:
        """Return the place of a row for an error message: its line, or its number."""
        if self.text is None:
            return f"sample {row + 1}"
        return f"line {_filled(self.text)[row + 1][0]}"


def read_tables(path: Path, content: bytes, columns: Sequence[str] | None) -> list[Table]:
    """Return the recordings in a file of any known format.

    content: of the file, decompressed. columns: names of time, x, y, z if the user gave them.
    Raises IdentificationError.
    """
    _check_count(path, content.count(b"\n"))
    if not content.strip():
        raise IdentificationError(f"{path}: the file is empty")
    names, _ = _header(content)
    if columns is not None:
        return [Table(_numbers(path, content, columns), content)]
    for read in FORMATS:
        if (tables := read(path, content, names)) is not None:
            return tables
    if any(name.lower().startswith("psd_") for name in names):
        raise IdentificationError(
            f"{path} is a spectrum that Klipper has computed, not a recording. Record again with "
            "TEST_RESONANCES AXIS=… OUTPUT=raw_data"
        )
    raise IdentificationError(
        f"{path} is not a Klipper accelerometer file; {_listed(names)}. If another program wrote "
        "it, name its columns: 'hframe-post identify --columns time,x,y,z'"
    )


def _shaketune(path: Path, content: bytes, _: list[str]) -> list[Table] | None:
    """Read a .stdata file of Shake&Tune: in each line a JSON object with a name and samples."""
    if not content.startswith(b"{"):
        return None
    return [_measurement(path, k, line) for k, line in enumerate(content.splitlines(), 1)]


def _measurement(path: Path, number: int, line: bytes) -> Table:
    _check_count(path, max(line.count(b"["), line.count(b",") // 4))  # as read they take 20 times
    try:
        read = json.loads(line)
    except (ValueError, RecursionError):
        raise IdentificationError(
            f"{path}: measurement {number} is not complete. Is the file cut off?"
        ) from None
    try:
        name, values = str(read["name"]), np.array(read["samples"] or np.zeros((0, 4)), float)
        if values.ndim != 2 or values.shape[1] != 4:
            raise ValueError
    except (KeyError, TypeError, ValueError, OverflowError):
        raise IdentificationError(
            f"{path}: measurement {number} does not consist of a name and samples of time, x, y "
            "and z: Shake&Tune did not write this file"
        ) from None
    return Table(values, name=name)


def _reprap(path: Path, content: bytes, names: list[str]) -> list[Table] | None:
    """Read what M956 of RepRapFirmware writes: numbered samples in g, and their rate at the end."""
    if [name.lower() for name in names] != REPRAP:
        return None
    *lines, last = content.rstrip().splitlines()
    rate = REPRAP_RATE.match(last)
    if rate is None or not float(rate[1]):
        raise IdentificationError(
            f"{path}: its last line does not tell the rate of its samples, as 'Rate 1391, "
            "overflows 0' does. Is the file cut off?"
        )
    values = _numbers(path, b"\n".join(lines), names)
    values[:, 0] /= float(rate[1])
    return [Table(values, content)]


def _labelled(path: Path, content: bytes, names: list[str]) -> list[Table] | None:
    """Read a table whose columns say what they are: time, and accelerations.

    ACCELEROMETER_MEASURE and TEST_RESONANCES write such, and so do other programs.
    """
    bare = [UNIT.sub("", name.strip("# ").lower()).replace(" ", "_") for name in names]
    times = [k for k, name in enumerate(bare) if name in TIMES]
    for form in ACCELERATIONS:
        axes = [form.format(axis) for axis in "xyz"]
        if len(times) == 1 and all(bare.count(axis) == 1 for axis in axes):
            chosen = [names[k] for k in (times[0], *(bare.index(axis) for axis in axes))]
            return [Table(_numbers(path, content, chosen), content, names == KLIPPER)]
    return None


FORMATS: tuple[Callable[[Path, bytes, list[str]], list[Table] | None], ...] = (
    _shaketune, _reprap, _labelled,
)  # fmt: skip


def _header(content: bytes) -> tuple[list[str], str]:
    head = content.lstrip()[:LONGEST_HEAD]
    line = head.partition(b"\n")[0].decode("utf-8-sig", "replace").strip()
    delimiter = max(",;\t", key=line.count)
    return [name.strip().strip("\"'") for name in line.split(delimiter)], delimiter


def _numbers(path: Path, content: bytes, columns: Sequence[str]) -> Array:
    names, delimiter = _header(content)
    chosen = [_column(path, names, name) for name in columns]
    if b"\n" not in content.strip():
        return np.zeros((0, 4))
    try:
        return np.asarray(
            np.loadtxt(io.BytesIO(content.lstrip()), delimiter=delimiter, skiprows=1,
                       usecols=chosen, comments=None, ndmin=2, encoding="latin-1")
        )  # fmt: skip
    except ValueError:
        raise _bad_line(path, content, delimiter, chosen) from None


def _filled(content: bytes) -> list[tuple[int, bytes]]:
    """Return the lines that are not blank, with their numbers; the first names the columns."""
    return [(k, line) for k, line in enumerate(content.splitlines(), 1) if line.strip()]


def _bad_line(
    path: Path, content: bytes, delimiter: str, chosen: Sequence[int]
) -> IdentificationError:
    _, *lines = _filled(content)
    for number, line in lines:
        parts = line.decode("latin-1").split(delimiter)
        try:
            [*map(float, [parts[place] for place in chosen])]
        except (IndexError, ValueError) as error:
            cause = "too few columns" if isinstance(error, IndexError) else "not a number"
            shown = repr(line.strip()[:LONGEST_NAME].decode("latin-1"))
            hint = " (is the file cut off?)" if number == lines[-1][0] else ""
            return IdentificationError(f"{path}: line {number}: {cause}: {shown}{hint}")
    return IdentificationError(f"{path} cannot be read as numbers")


def _check_count(path: Path, samples: int) -> None:
    if samples > MOST_SAMPLES + 10:  # with heads
        raise IdentificationError(
            f"{path}: {samples} samples are too many for the recording of a test; at most "
            f"{MOST_SAMPLES} are read"
        )


def _column(path: Path, names: list[str], name: str) -> int:
    if names.count(name) != 1:
        cause = f"there is no column {name}" if name not in names else f"{name} occurs twice"
        raise IdentificationError(f"{path}: {cause}; {_listed(names)}")
    return names.index(name)


def _listed(names: list[str]) -> str:
    return "the file has: " + ", ".join(name[:LONGEST_NAME] for name in names[:10])
