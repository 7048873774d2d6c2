"""The file of a command: x and y every millisecond, as CSV."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.packed import unpacked
from hframe_post.native import digits

CSV_HEAD = "t,x,y"


def command_csv(command: Array) -> Iterator[bytes]:
    """Yield a command (m, 2) as CSV: ``t,x,y`` in s and mm, one row a millisecond, t from 0."""
    yield CSV_HEAD.encode() + b"\n"
    t = np.arange(len(command)) * TS
    comma = digits.column(b",", len(command))
    at, x, y = (digits.fixed(values, 6) for values in (t, *command.T))
    yield digits.rows([at, comma, x, comma, y, digits.column(b"\n", len(command))])


def read_command(path: Path) -> Array:
    """Read x and y (m, 2) in mm from a command's CSV file.

    Raises OSError, and IdentificationError with the line and the cause.
    """
    lines = unpacked(path).decode("latin-1").splitlines()
    if not lines or lines[0].strip().lower() != CSV_HEAD:
        raise IdentificationError(
            f"{path} is not the command of a motion, whose first line is {CSV_HEAD}. Give the "
            "command first and the recording after it"
        )
    if sum(bool(line.strip()) for line in lines[1:]) < 1000:
        raise IdentificationError(f"{path}: too short for a command: at least 1000 rows are needed")
    try:
        rows = np.loadtxt(lines[1:], delimiter=",", comments=None, ndmin=2)
    except ValueError as error:
        raise IdentificationError(f"{path} cannot be read as numbers: {error}") from None
    if rows.shape[1] != 3:
        raise IdentificationError(f"{path}: rows must have three columns, {CSV_HEAD}")
    if not np.isfinite(rows).all():
        raise IdentificationError(f"{path} has values that are not finite")
    late = np.abs(rows[:, 0] - rows[0, 0] - np.arange(len(rows)) * TS) > 1e-6
    if late.any():
        raise IdentificationError(
            f"{path}: line {int(np.argmax(late)) + 2}: rows must be 1 ms apart"
        )
    return np.asarray(rows[:, 1:])
