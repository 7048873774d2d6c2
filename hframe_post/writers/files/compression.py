"""Files that are compressed as they are written, by their suffix: .gz and .zst."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, cast

from hframe_post.errors import HframeError

GZIP_LEVEL = 6
ZSTD_LEVEL = 3


@contextmanager
def compressing(file: IO[bytes], suffix: str) -> Iterator[IO[bytes]]:
    """What is written arrives in ``file`` as its suffix says; any other suffix: as it is.

    Equal input gives equal bytes: no name, no date. Raises HframeError without zstandard.
    """
    if suffix == ".gz":
        with gzip.GzipFile("", "wb", GZIP_LEVEL, file, mtime=0) as packed:
            yield cast(IO[bytes], packed)
    elif suffix == ".zst":
        compressor = _zstandard().ZstdCompressor(level=ZSTD_LEVEL)
        with compressor.stream_writer(file, closefd=False) as packed:
            yield cast(IO[bytes], packed)
    else:
        yield file


@contextmanager
def decompressing(path: Path) -> Iterator[IO[bytes]]:
    """The contents of a file, unpacked as its suffix says. Raises OSError, HframeError."""
    with path.open("rb") as file:
        if path.suffix == ".gz":
            with gzip.GzipFile(fileobj=file) as unpacked:
                yield cast(IO[bytes], unpacked)
        elif path.suffix == ".zst":
            reader = _zstandard().ZstdDecompressor().stream_reader(file, read_across_frames=True)
            yield cast(IO[bytes], reader)
        else:
            yield file


def _zstandard() -> Any:
    try:
        import zstandard
    except ImportError:
        raise HframeError(".zst needs an extra: pip install 'hframe-post[zstd]'") from None
    return zstandard
