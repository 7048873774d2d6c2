"""Content of files that may be compressed, none of which may unpack to more than MAX_SIZE.

gzip, xz and zstd are recognized by a file's first bytes.
"""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import zstandard

from hframe_post.errors import IdentificationError

MAX_SIZE = 1 << 28  # bytes, decompressed; two minutes of an ADXL345 are 20 MB
MEMORY = 1 << 28  # bytes that a decompressor may need for what it has read
PIECE = 1024  # bytes of zstd, which may grow to 32 MB each
BROKEN = (OSError, lzma.LZMAError, zlib.error, zstandard.ZstdError)
GZIP, XZ, ZSTD = b"\x1f\x8b", b"\xfd7zXZ\0", b"\x28\xb5\x2f\xfd"


class _TooLargeError(Exception):
    """Content is larger than MAX_SIZE."""


def unpacked(path: Path) -> bytes:
    """Return a file's content, decompressed. Its first bytes show the format, not its name.

    Raises OSError, and IdentificationError if it is cut off, damaged or too large.
    """
    if path.stat().st_size > MAX_SIZE:
        raise _too_large(path)
    content = path.read_bytes()
    opener = next((each for magic, each in OPENERS.items() if content.startswith(magic)), None)
    if opener is None:
        return content
    try:
        return opener(content)
    except _TooLargeError:
        raise _too_large(path) from None
    except EOFError:
        raise IdentificationError(f"{path}: the compressed file is cut off") from None
    except BROKEN as error:
        raise IdentificationError(f"{path} cannot be decompressed: {error}") from None


def _too_large(path: Path) -> IdentificationError:
    return IdentificationError(
        f"{path}: the file is too large for a recording: unpacked it would have more than "
        f"{MAX_SIZE >> 20} MB. Give the recording of a single test"
    )


class _Decompressor(Protocol):
    """Decompressor of one stream. unused_data: what follows it."""

    def decompress(self, data: bytes, max_length: int, /) -> bytes: ...
    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes: ...


def _streams(content: bytes, start: Callable[[], _Decompressor]) -> bytes:
    """Return what streams, one behind another, unpack to.

    Raises EOFError if the last is cut off, and _TooLargeError.
    """
    parts, left = [], MAX_SIZE + 1
    while content:
        stream = start()
        parts.append(stream.decompress(content, left))
        left -= len(parts[-1])
        if left <= 0:
            raise _TooLargeError
        if not stream.eof:
            raise EOFError
        content = stream.unused_data.lstrip(b"\0")  # to which files may be filled up
    return b"".join(parts)


def _zstd(content: bytes) -> bytes:
    parts, size = list[bytes](), 0
    reader = zstandard.ZstdDecompressor().decompressobj()
    for first in range(0, len(content), PIECE):
        waiting = content[first : first + PIECE]
        while waiting:
            if reader.eof:
                reader = zstandard.ZstdDecompressor().decompressobj()
            parts.append(reader.decompress(waiting))
            size += len(parts[-1])
            if size > MAX_SIZE:
                raise _TooLargeError
            waiting = reader.unused_data
    if not reader.eof:
        raise EOFError
    return b"".join(parts)


OPENERS: dict[bytes, Callable[[bytes], bytes]] = {  # by a file's first bytes
    GZIP: lambda content: _streams(content, lambda: zlib.decompressobj(31)),
    XZ: lambda content: _streams(content, lambda: lzma.LZMADecompressor(memlimit=MEMORY)),
    ZSTD: _zstd,
}
