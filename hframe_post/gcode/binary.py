"""Prusa's binary G-code (.bgcode), through libbgcode's Python binding, an optional extra.

It is converted to text before reading and from text after writing, in temporary files, since
libbgcode works on files.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

from hframe_post.errors import GcodeError, HframeError

MAGIC = b"GCDE"
SUFFIX = ".bgcode"


def is_binary(path: Path) -> bool:
    """Return whether the first bytes of a file are those of binary G-code."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


@contextmanager
def as_text(first: bytes, rest: IO[bytes]) -> Iterator[IO[bytes]]:
    """Open the text of binary G-code that begins with the bytes ``first``. Raises GcodeError."""
    with TemporaryDirectory(prefix="hframe-post-") as folder:
        binary, text = Path(folder, "binary"), Path(folder, "text")
        with binary.open("wb") as copy:
            copy.write(first)
            shutil.copyfileobj(rest, copy)
        cause = _convert("from_binary_to_ascii", binary, text, verify=True)
        if cause is not None:
            raise GcodeError(f"this binary G-code cannot be read: {cause}")
        with text.open("rb") as file:
            yield file


@contextmanager
def as_binary(target: IO[bytes]) -> Iterator[IO[bytes]]:
    """Open a file for text that becomes binary G-code in ``target``. Raises HframeError."""
    with TemporaryDirectory(prefix="hframe-post-") as folder:
        text, binary = Path(folder, "text"), Path(folder, "binary")
        with text.open("w+b") as file:
            yield file
        cause = _convert("from_ascii_to_binary", text, binary)
        if cause is not None:
            raise HframeError(f"this cannot be written as binary G-code: {cause}")
        with binary.open("rb") as whole:
            shutil.copyfileobj(whole, target)


def _convert(function: str, source: Path, target: Path, verify: bool = False) -> str | None:
    """Convert a file; return the error message, if there is one."""
    bgcode = _library()
    opened = [bgcode.open(str(source), "rb"), bgcode.open(str(target), "wb")]
    try:
        result = getattr(bgcode, function)(*opened, *((True,) if verify else ()))
    except (RuntimeError, ValueError, MemoryError) as error:
        return str(error)
    finally:
        for file in opened:
            bgcode.close(file)
    if result == bgcode.EResult.Success:
        return None
    return str(bgcode.translate_result(result))


def _library() -> Any:
    try:
        import pybgcode
    except ImportError:
        raise HframeError(
            "this is binary G-code: run pip install 'hframe-post[bgcode]' to read and write it, "
            "or turn off 'Supports binary G-code' in the slicer's printer settings and slice again"
        ) from None
    return pybgcode
