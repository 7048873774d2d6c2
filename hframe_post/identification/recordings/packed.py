"""Content of files that may be compressed with gzip, xz or zstd."""

from __future__ import annotations

import gzip
import io
import lzma
import zlib
from collections.abc import Callable
from pathlib import Path

import zstandard

from hframe_post.errors import IdentificationError

MAX_SIZE = 1 << 29  # bytes, decompressed; two minutes of an ADXL345 are 20 MB
BROKEN = (OSError, lzma.LZMAError, zlib.error, zstandard.ZstdError)


def unpacked(path: Path) -> bytes:
    """Return a file's content, decompressed. Its first bytes show the format, not its name.

    Raises OSError, and IdentificationError if it is cut off, damaged or too large.
    """
    too_large = IdentificationError(f"{path}: the file is too large for a recording")
    if path.stat().st_size > MAX_SIZE:
        raise too_large
    content = path.read_bytes()
    opener = next((each for magic, each in OPENERS.items() if content.startswith(magic)), None)
    if opener is None:
        return content
    try:
        result = opener(content)
    except EOFError:
        raise IdentificationError(f"{path}: the compressed file is cut off") from None
    except BROKEN as error:
        raise IdentificationError(f"{path} cannot be decompressed: {error}") from None
    if len(result) > MAX_SIZE:
        raise too_large
    return result


def _gzip(content: bytes) -> bytes:
    with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
        return file.read(MAX_SIZE + 1)


def _xz(content: bytes) -> bytes:
    with lzma.LZMAFile(io.BytesIO(content)) as file:
        return file.read(MAX_SIZE + 1)


def _zstd(content: bytes) -> bytes:
    parts: list[bytes] = []
    reader = zstandard.ZstdDecompressor().decompressobj()
    for first in range(0, len(content), 4096):  # which may grow to 128 MB each
        waiting = content[first : first + 4096]
        while waiting:
            if reader.eof:
                reader = zstandard.ZstdDecompressor().decompressobj()
            parts.append(reader.decompress(waiting))
            waiting = reader.unused_data
        if sum(map(len, parts)) > MAX_SIZE:
            break
    else:
        if not reader.eof:
            raise EOFError
    return b"".join(parts)


OPENERS: dict[bytes, Callable[[bytes], bytes]] = {  # by a file's first bytes
    b"\x1f\x8b": _gzip,
    b"\xfd7zXZ\0": _xz,
    b"\x28\xb5\x2f\xfd": _zstd,
}
