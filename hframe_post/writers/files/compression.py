"""Files that are compressed as they are written if their suffix is .gz."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, cast

from hframe_post.errors import HframeError


@contextmanager
def compressing(file: IO[bytes], suffix: str) -> Iterator[IO[bytes]]:
    """Yield a file that writes to ``file``, compressed if the suffix is .gz.

    Equal input gives equal bytes: no name, no date.
    """
    if suffix != ".gz":
        yield file
        return
    with gzip.GzipFile("", "wb", 6, file, mtime=0) as packed:
        yield cast(IO[bytes], packed)


@contextmanager
def decompressing(path: Path) -> Iterator[IO[bytes]]:
    """Yield the contents of a file, unpacked if its suffix is .gz. Raises OSError, HframeError."""
    if path.suffix == ".zst":
        raise HframeError(f"{path}: .zst is not read any more: unpack it with 'zstd -d {path}'")
    with path.open("rb") as file:
        if path.suffix != ".gz":
            yield file
            return
        with gzip.GzipFile(fileobj=file) as unpacked:
            yield cast(IO[bytes], unpacked)
