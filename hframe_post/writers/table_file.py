"""Tables of numbers as .npz and .parquet, written as they grow, in constant memory."""

from __future__ import annotations

import io
import shutil
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import HframeError

ROWS_PER_GROUP = 1 << 17  # of parquet, whose table of contents grows with the groups
NO_DATE = (1980, 1, 1, 0, 0, 0)  # the earliest that a zip file knows


def write_npz(
    file: IO[bytes], tables: Iterable[Array], names: tuple[str, ...], stamp: str, folder: Path
) -> None:
    """One array a column, as of ``np.savez``, and the text ``stamp``; equal bytes for equal input.

    A column's length is known only at its end, so columns wait in temporary files in ``folder``.
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
    return archive.open(zipfile.ZipInfo(f"{name}.npy", NO_DATE), "w", force_zip64=True)


def write_parquet(
    file: IO[bytes], tables: Iterable[Array], names: tuple[str, ...], stamp: str
) -> None:
    """One column of doubles each, and ``stamp`` in the metadata.

    Raises HframeError without pyarrow.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise HframeError(".parquet needs an extra: pip install 'hframe-post[parquet]'") from None
    fields = [pa.field(name, pa.float64(), nullable=False) for name in names]
    schema = pa.schema(fields, metadata={"stamp": stamp})
    # bytes of equal weight together: neighbours share them, and zstd sees it
    packing = {"compression": "zstd", "use_byte_stream_split": True, "use_dictionary": False}
    with parquet.ParquetWriter(file, schema, **packing) as writer:
        for group in _groups(tables):
            columns = [pa.array(np.ascontiguousarray(column)) for column in group.T]
            writer.write_table(pa.table(columns, schema=schema))


def _groups(tables: Iterable[Array]) -> Iterator[Array]:
    """Tables joined to groups of ROWS_PER_GROUP rows at least, but for the last."""
    held: list[Array] = []
    for table in tables:
        held.append(table)
        if sum(map(len, held)) >= ROWS_PER_GROUP:
            yield np.concatenate(held)
            held = []
    if held:
        yield np.concatenate(held)
