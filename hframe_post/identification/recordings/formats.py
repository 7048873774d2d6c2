"""Formats of accelerometer files.

To support another format, write a function that returns a Table, and call it in ``read_tables``.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.packed import check_zip

COMMAND = ("t", "x", "y")  # as sweep and verify write it
KLIPPER = ("#time", "accel_x", "accel_y", "accel_z")
M956 = ("Sample", "X", "Y", "Z")
M956_END = re.compile(rb"\s*Rate (\d+), overflows (\d+)\s*")
ACCELERATIONS = (
    "accel_{}", "acceleration_{}", "acc_{}", "a{}", "a_{}", "{}_accel", "{}_acc", "{}",
)  # fmt: skip
UNIT = re.compile(r"[ _]*(?:\((?P<a>[^)]*)\)|\[(?P<b>[^\]]*)\]|_(?P<c>g|mm/s2|m/s2|s))$")
UNIT_NAMES = {"g": "g", "m/s2": "m/s2", "m/s^2": "m/s2", "m/s²": "m/s2",
              "mm/s2": "mm/s2", "mm/s^2": "mm/s2", "mm/s²": "mm/s2"}  # fmt: skip
MOST_SAMPLES = 1 << 22  # of a recording: 20 minutes of an ADXL345
LONGEST_NAME = 40  # characters of a column's name or a bad line, as errors show it


@dataclass(frozen=True, slots=True)
class Table:
    """One recording in a file: time (s) and three accelerations, (n, 4).

    text: the file, if it has lines, so that errors can name them. unit: of the accelerations;
    None if the format does not fix it. starts_with_command: whether the program that wrote the
    file began recording with the first sample of the command. name: of the recording, if the
    file names it.
    """

    values: Array
    text: bytes | None = None
    unit: str | None = None
    starts_with_command: bool = False
    name: str = ""

    def where(self, row: int) -> str:
        """Return the place of a row for an error message: its line, or its number."""
        if self.text is None:
            return f"sample {row + 1}"
        filled = [k for k, line in enumerate(self.text.splitlines(), 1) if line.strip()]
        return f"line {filled[row + 1]}"


def read_tables(path: Path, content: bytes, columns: Sequence[str] | None) -> list[Table]:
    """Return the recordings in a file of any known format.

    content: of the file, decompressed. columns: names of time, x, y, z if the user gave them.
    Raises IdentificationError.
    """
    if path.suffix == ".npz":
        return [Table(_named_arrays(path, content, columns))]
    _check_count(path, content.count(b"\n"))
    if columns is not None:
        return [_text(path, content, columns)]
    if content.startswith(b"{"):
        return [_measurement(path, k, line) for k, line in enumerate(content.splitlines(), 1)]
    names = tuple(_header(content)[0])
    if names == KLIPPER:  # always in mm/s²
        values = _numbers(path, content, KLIPPER)
        return [Table(values, content, "mm/s2", starts_with_command=True)]
    if names == COMMAND:
        raise IdentificationError(
            f"{path} is the command of a motion, not a recording. Give the command first and the "
            "recording after it"
        )
    if names[:1] == M956[:1] and set(names) <= set(M956):
        return [_m956(path, content, names)]
    return [_recognized(path, content, names)]


def _measurement(path: Path, number: int, line: bytes) -> Table:
    """Read one line of a .stdata file of Shake&Tune: a JSON object with a name and samples."""
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
    return Table(values, None, "mm/s2", False, name)


def _m956(path: Path, content: bytes, names: Sequence[str]) -> Table:
    """Read what M956 of RepRapFirmware wrote: samples in g, and their rate in the last line."""
    if len(names) < len(M956):
        raise IdentificationError(
            f"{path} has only {', '.join(names[1:]) or 'no axis'}. Record all three axes: M956 "
            "without X, Y and Z"
        )
    body, _, last = content.rstrip().rpartition(b"\n")
    found = M956_END.fullmatch(last)
    if found is None or not int(found[1]):
        raise IdentificationError(
            f"{path}: the last line is not 'Rate …, overflows …'. The file is cut off, or the "
            "accelerometer failed"
        )
    if int(found[2]):
        raise IdentificationError(
            f"{path}: samples are missing: {int(found[2])} overflows at unknown times. Set a lower "
            "rate (M955 S) and record again"
        )
    values = _numbers(path, body, M956)
    values[:, 0] /= float(found[1])
    return Table(values, body, "g")


def _recognized(path: Path, content: bytes, names: Sequence[str]) -> Table:
    """Read another program's table if its columns say what they are: time, and accelerations."""
    bare = [UNIT.sub("", name.strip("# ").lower()).replace(" ", "_") for name in names]
    units = [_unit_of(name) for name in names]
    times = [k for k, name in enumerate(bare) if name in ("time", "t", "timestamp")]
    for form in ACCELERATIONS:
        axes = [form.format(axis) for axis in "xyz"]
        if len(times) == 1 and all(bare.count(axis) == 1 for axis in axes):
            places = [times[0], *(bare.index(axis) for axis in axes)]
            unit = UNIT_NAMES.get(units[places[1]])
            return Table(_numbers(path, content, [names[k] for k in places]), content, unit)
    return _text(path, content, None)


def _unit_of(name: str) -> str:
    found = UNIT.search(name.lower())
    return next(filter(None, found.groups()), "").strip() if found else ""


# ---------------------------------------------------------------------- text


def _header(content: bytes) -> tuple[list[str], str]:
    line = content.lstrip().partition(b"\n")[0].decode("utf-8-sig", "replace").strip()
    delimiter = max(",;\t", key=line.count)
    return [name.strip().strip("\"'") for name in line.split(delimiter)], delimiter


def _text(path: Path, content: bytes, columns: Sequence[str] | None) -> Table:
    if not content.strip():
        raise IdentificationError(f"{path}: the file is empty")
    names, _ = _header(content)
    if any(name.lower().startswith("psd_") for name in names):
        raise IdentificationError(
            f"{path} is a spectrum that Klipper has computed, not a recording. Record again with "
            "TEST_RESONANCES AXIS=… OUTPUT=raw_data"
        )
    if columns is None:
        raise IdentificationError(
            f"{path} is not a Klipper accelerometer file. If another program wrote it, name its "
            f"columns: 'hframe-post identify --columns time,x,y,z'; {_listed(names)}"
        )
    return Table(_numbers(path, content, columns), content)


def _numbers(path: Path, content: bytes, columns: Sequence[str]) -> Array:
    names, delimiter = _header(content)
    chosen = [_column(path, names, name) for name in columns]
    if b"\n" not in content.strip():
        return np.zeros((0, 4))
    skipped = _lines_to_names(content)
    try:
        return np.asarray(
            np.loadtxt(io.BytesIO(content), delimiter=delimiter, skiprows=skipped, usecols=chosen,
                       comments=None, ndmin=2, encoding="latin-1")
        )  # fmt: skip
    except ValueError:
        raise _bad_line(path, content, delimiter, chosen) from None


def _lines_to_names(content: bytes) -> int:
    return content[: len(content) - len(content.lstrip())].count(b"\n") + 1


def _bad_line(
    path: Path, content: bytes, delimiter: str, chosen: Sequence[int]
) -> IdentificationError:
    lines = content.splitlines()
    first = _lines_to_names(content)
    for number, line in enumerate(lines[first:], first + 1):
        parts = line.decode("latin-1").split(delimiter)
        if not line.strip():
            continue
        shown = repr(line.strip()[:LONGEST_NAME].decode("latin-1"))
        if len(parts) <= max(chosen):
            hint = " (is the file cut off?)" if number == len(lines) else ""
            return IdentificationError(f"{path}: line {number}: too few columns: {shown}{hint}")
        try:
            [float(parts[place]) for place in chosen]
        except ValueError:
            return IdentificationError(f"{path}: line {number}: not a number: {shown}")
    return IdentificationError(f"{path} cannot be read as numbers")


# ---------------------------------------------------------------------- files of arrays


def _named_arrays(path: Path, content: bytes, columns: Sequence[str] | None) -> Array:
    """Return the arrays of the user's names in an archive of NumPy, (n, 4)."""
    try:
        check_zip(path, content)
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            if columns is None:
                raise IdentificationError(
                    f"{path}: name the arrays of time and x, y, z: 'hframe-post identify --columns "
                    f"time,x,y,z'; {_listed(file.files)}"
                )
            chosen = []
            for name in columns:
                _column(path, file.files, name)
                array = np.squeeze(file[name])
                if array.ndim != 1 or array.dtype.kind not in "fiu":
                    raise IdentificationError(f"{path}: {name} is not a list of real numbers")
                _check_count(path, len(array))
                chosen.append(array.astype(np.float64))
    except IdentificationError:
        raise
    except Exception as error:  # a broken file fails in many ways
        raise IdentificationError(f"{path} cannot be read as .npz: {str(error)[:200]}") from None
    if len({len(array) for array in chosen}) > 1:
        sizes = ", ".join(f"{n}: {len(a)}" for n, a in zip(columns, chosen, strict=True))
        raise IdentificationError(f"{path}: the arrays differ in length ({sizes})")
    return np.column_stack(chosen)


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
