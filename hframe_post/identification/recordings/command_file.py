"""The command of a run, as CSV: ``t,x,y`` in s and mm, one row a millisecond."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.number_table import read_table
from hframe_post.writers.stream import digits

HEAD = "t,x,y"
UNEVEN = 1e-6  # s by which a row may miss its millisecond
FEWEST = 1000  # rows


def written(command: Array) -> Iterator[bytes]:
    """The command (m, 2) as text, t from 0."""
    yield HEAD.encode() + b"\n"
    t = np.arange(len(command)) * TS
    comma = digits.column(b",", len(command))
    parts = [digits.fixed(values, 6) for values in (t, *command.T)]
    yield digits.rows(
        [parts[0], comma, parts[1], comma, parts[2], digits.column(b"\n", len(command))]
    )


def read(path: Path) -> Array:
    """x and y (m, 2) in mm. Raises IdentificationError with the line and the cause."""
    lines = path.read_bytes().decode("latin-1").splitlines()
    if not lines or lines[0].strip().lower() != HEAD:
        raise IdentificationError(
            f"{path}: line 1: not the command of a sweep, which begins with {HEAD!r}"
        )
    try:
        rows = read_table(lines[1:], delimiter=",")
    except ValueError as error:
        raise IdentificationError(f"{path}: cannot be read as numbers: {error}") from None
    if rows.shape[1:] != (len(HEAD.split(",")),) or len(rows) < FEWEST:
        raise IdentificationError(f"{path}: {len(rows)} rows of t, x, y are too few")
    if not np.isfinite(rows).all():
        raise IdentificationError(f"{path}: has values that are not finite")
    late = np.abs(rows[:, 0] - rows[0, 0] - np.arange(len(rows)) * TS) > UNEVEN
    if late.any():
        raise IdentificationError(
            f"{path}: line {int(np.argmax(late)) + 2}: rows must be 1 ms apart"
        )
    return rows[:, 1:]
