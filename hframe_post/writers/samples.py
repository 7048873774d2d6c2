"""Samples → a table of numbers, one row a millisecond: path, command, predicted motion.

Tables become CSV or .npz as they grow, in constant memory.
"""

from __future__ import annotations

import io
import shutil
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import IO

import numpy as np

from hframe_post.arrays import TS, Array, E, Z
from hframe_post.model.nozzle import Response
from hframe_post.model.plant import Plant
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
            nozzle, turns = response.motion(following[loaded.ahead :])
            theta = turns[:, 0] if plant.Gxtheta else np.zeros(len(command))
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
