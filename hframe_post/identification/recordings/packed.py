"""Content of files that may be compressed, none of which may unpack to more than MAX_SIZE.

gzip, xz and zstd are recognized by a file's first bytes. The zip archives of NumPy (.npz) and the
compressed arrays of MATLAB (.mat) are unpacked here, too, so that one limit holds for all.
"""

from __future__ import annotations

import io
import lzma
import struct
import zipfile
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
MATLAB_HEAD, MATLAB_COMPRESSED = 128, 15


class TooLargeError(Exception):
    """Content is larger than MAX_SIZE."""


def unpacked(path: Path) -> bytes:
    """Return a file's content, decompressed. Its first bytes show the format, not its name.

    Raises OSError, and IdentificationError if it is cut off, damaged or too large.
    """
    if path.stat().st_size > MAX_SIZE:
        raise too_large(path)
    content = path.read_bytes()
    opener = next((each for magic, each in OPENERS.items() if content.startswith(magic)), None)
    if opener is None:
        return content
    try:
        return opener(content)
    except TooLargeError:
        raise too_large(path) from None
    except EOFError:
        raise IdentificationError(f"{path}: the compressed file is cut off") from None
    except BROKEN as error:
        raise IdentificationError(f"{path} cannot be decompressed: {error}") from None


def too_large(path: Path) -> IdentificationError:
    return IdentificationError(
        f"{path}: the file is too large for a recording: unpacked it would have more than "
        f"{MAX_SIZE >> 20} MB. Give the recording of a single test"
    )


def head(path: Path, count: int) -> bytes:
    """Return the first bytes of a file's content, decompressed; at most ``count`` of them.

    They are empty if the file is damaged. Raises OSError.
    """
    with path.open("rb") as file:
        start = file.read(1 << 16)
    try:
        if start.startswith(GZIP):
            return zlib.decompressobj(31).decompress(start, count)
        if start.startswith(XZ):
            return lzma.LZMADecompressor(memlimit=MEMORY).decompress(start, count)
        if start.startswith(ZSTD):
            return zstandard.ZstdDecompressor().stream_reader(start).read(count)
    except BROKEN:
        return b""
    return start[:count]


class _Decompressor(Protocol):
    """Decompressor of one stream. unused_data: what follows it."""

    def decompress(self, data: bytes, max_length: int, /) -> bytes: ...
    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes: ...


def _streams(content: bytes, start: Callable[[], _Decompressor]) -> bytes:
    """Return what streams, one behind another, unpack to.

    Raises EOFError if the last is cut off, and TooLargeError.
    """
    parts, left = [], MAX_SIZE + 1
    while content:
        stream = start()
        parts.append(stream.decompress(content, left))
        left -= len(parts[-1])
        if left <= 0:
            raise TooLargeError
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
                raise TooLargeError
            waiting = reader.unused_data
    if not reader.eof:
        raise EOFError
    return b"".join(parts)


OPENERS: dict[bytes, Callable[[bytes], bytes]] = {  # by a file's first bytes
    GZIP: lambda content: _streams(content, lambda: zlib.decompressobj(31)),
    XZ: lambda content: _streams(content, lambda: lzma.LZMADecompressor(memlimit=MEMORY)),
    ZSTD: _zstd,
}


# ---------------------------------------------------------------------- files of arrays


def check_zip(content: bytes) -> None:
    """Raise TooLargeError if a zip archive would unpack to more than MAX_SIZE.

    Its directory tells, as no more than that is read of any file in it. Raises ValueError if it is
    compressed by a method that cannot be read in parts, and zipfile.BadZipFile.
    """
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        inside = archive.infolist()
    if sum(one.file_size for one in inside) > MAX_SIZE:
        raise TooLargeError
    if any(one.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for one in inside):
        raise ValueError("it is not compressed as NumPy does. Save it with numpy.savez_compressed")


def unpacked_matlab(content: bytes) -> bytes:
    """Return a .mat file with its compressed arrays replaced by what they unpack to.

    Other versions than 5 are returned as they are. Raises EOFError, zlib.error and TooLargeError.
    """
    order = {b"\0\1IM": "<", b"\1\0MI": ">"}.get(content[124:MATLAB_HEAD])
    if order is None or 0 in content[:4]:
        return content
    parts, at, size = [content[:MATLAB_HEAD]], MATLAB_HEAD, 0
    while at + 8 <= len(content):
        kind, length = struct.unpack_from(f"{order}II", content, at)
        end = at + 8 + length
        compressed = kind == MATLAB_COMPRESSED
        part = content[at:end]
        parts.append(_streams(part[8:], zlib.decompressobj) if compressed else part)
        size += len(parts[-1])
        if size > MAX_SIZE:
            raise TooLargeError
        at = end
    return b"".join(parts)
