"""Samples → a table of numbers, one row a millisecond: path, command, predicted motion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from hframe_post.arrays import TS, Array, Z
from hframe_post.model.plant import Plant, Response
from hframe_post.stream.chunks import batches, stretches
from hframe_post.stream.types import Samples
from hframe_post.writers.stream import digits

# Path, command, lift and filament, prediction. s, mm, rad.
COLUMNS = ("t", "x_d", "y_d", "x_dm", "y_dm", "z", "e", "theta", "x", "y")
DECIMALS = (3, 6, 6, 6, 6, 6, 6, 9, 6, 6)
ROWS_AT_ONCE = 1 << 14  # a multiple of plant.BLOCK_SAMPLES: equal bits whatever the chunks


def tabulate(chunks: Iterable[Samples], strategy: str, plant: Plant) -> Iterator[Array]:
    """Tables (n, len(COLUMNS)) of a strategy's command. t: the end of a sample's millisecond.

    The prediction starts from rest wherever the machine may stand anew.
    """
    for stretch in stretches(chunks):
        response: Response | None = None
        for chunk in batches(stretch, ROWS_AT_ONCE):
            if not len(chunk):
                continue
            command = chunk.commands[strategy]
            response = response or Response(plant, chunk.xyze[0, :Z])
            x, y, theta = response.motion(command).T
            t = np.arange(chunk.first + 1, chunk.end + 1) * TS
            yield np.column_stack([t, chunk.xyze[:, :Z], command, chunk.xyze[:, Z:], theta, x, y])


def as_csv(tables: Iterable[Array]) -> Iterator[bytes]:
    """The tables as text, the columns' names first."""
    yield ",".join(COLUMNS).encode() + b"\n"
    for table in tables:
        comma, newline = digits.column(b",", len(table)), digits.column(b"\n", len(table))
        columns = [
            part
            for values, decimals in zip(table.T, DECIMALS, strict=True)
            for part in (digits.fixed(values, decimals), comma)
        ]
        yield digits.rows([*columns[:-1], newline])
