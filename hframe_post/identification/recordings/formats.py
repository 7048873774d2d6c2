"""Formats of accelerometer files.

To support another format, write a function that returns a Table, and call it in ``read_table``.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import IdentificationError

KLIPPER = ("#time", "accel_x", "accel_y", "accel_z")
LONGEST_NAME = 40  # characters of a column's name or a bad line, as errors show it


@dataclass(frozen=True, slots=True)
class Table:
    """What a file holds: time (s) and three accelerations, (n, 4).

    text: the file, if it has lines, so that errors can name them. unit: of the accelerations;
    None if the format does not fix it. starts_with_command: whether the program that wrote the
    file began recording with the first sample of the command.
    """

    values: Array
    text: bytes | None = None
    unit: str | None = None
    starts_with_command: bool = False

    def where(self, row: int) -> str:
        """Return the place of a row for an error message: its line, or its number."""
        if self.text is None:
            return f"sample {row + 1}"
        filled = [k for k, line in enumerate(self.text.splitlines(), 1) if line.strip()]
        return f"line {filled[row + 1]}"


def read_table(path: Path, columns: Sequence[str] | None) -> Table:
    """Read a file of any known format. columns: names of time, x, y, z if the user gave them.

    Raises OSError or IdentificationError.
    """
    content = path.read_bytes()
    if path.suffix in (".npz", ".mat"):
        return Table(_named_arrays(path, _arrays(path, content), columns))
    if columns is None and tuple(_header(content)[0]) == KLIPPER:  # always in mm/s²
        return Table(_numbers(path, content, KLIPPER), content, "mm/s2", starts_with_command=True)
    return _text(path, content, columns)


# ---------------------------------------------------------------------- text


def _header(content: bytes) -> tuple[list[str], str]:
    line = content.lstrip().partition(b"\n")[0].decode("utf-8-sig", "replace").strip()
    delimiter = max(",;\t", key=line.count)
    return [name.strip().strip("\"'") for name in line.split(delimiter)], delimiter


def _text(path: Path, content: bytes, columns: Sequence[str] | None) -> Table:
    if not content.strip():
        raise IdentificationError(f"{path}: the file is empty")
    names, _ = _header(content)
    if "psd_xyz" in names:
        raise IdentificationError(
            f"{path} is a spectrum that Klipper has computed, not a recording. Use the file that "
            "ACCELEROMETER_MEASURE wrote, which begins with #time"
        )
    if columns is None:
        raise IdentificationError(
            f"{path} is not a Klipper accelerometer file. If another program wrote it, name its "
            f"columns: --columns time,x,y,z; {_listed(names)}"
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


def _arrays(path: Path, content: bytes) -> dict[str, Any]:
    try:
        if path.suffix == ".npz":
            with np.load(io.BytesIO(content), allow_pickle=False) as file:
                return dict(file)
        from scipy.io import loadmat

        arrays = loadmat(io.BytesIO(content))
        return {name: value for name, value in arrays.items() if not name.startswith("__")}
    except Exception as error:  # a broken file fails in many ways
        cause = f" cannot be read as {path.suffix}: {str(error)[:200]}"
        if path.suffix == ".mat" and isinstance(error, NotImplementedError):
            cause = ": MATLAB 7.3 files cannot be read. Save the file with -v7"
        raise IdentificationError(f"{path}{cause}") from None


def _named_arrays(path: Path, arrays: Mapping[str, Any], columns: Sequence[str] | None) -> Array:
    if columns is None:
        raise IdentificationError(
            f"{path}: name the arrays of time and x, y, z: --columns time,x,y,z; "
            f"{_listed(list(arrays))}"
        )
    chosen = []
    for name in columns:
        _column(path, list(arrays), name)
        array = np.squeeze(np.asarray(arrays[name]))
        if array.ndim != 1 or array.dtype.kind not in "fiu":
            raise IdentificationError(f"{path}: {name} is not a list of real numbers")
        chosen.append(array.astype(np.float64))
    if len({len(array) for array in chosen}) > 1:
        sizes = ", ".join(f"{n}: {len(a)}" for n, a in zip(columns, chosen, strict=True))
        raise IdentificationError(f"{path}: the arrays differ in length ({sizes})")
    return np.column_stack(chosen)


def _column(path: Path, names: list[str], name: str) -> int:
    if names.count(name) != 1:
        cause = f"there is no column {name}" if name not in names else f"{name} occurs twice"
        raise IdentificationError(f"{path}: {cause}; {_listed(names)}")
    return names.index(name)


def _listed(names: list[str]) -> str:
    return "the file has: " + ", ".join(name[:LONGEST_NAME] for name in names[:10])
