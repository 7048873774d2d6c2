"""Prusa's binary G-code (.bgcode), by libbgcode's Python binding: an optional extra.

It is turned into text before it is read, and the text written into it: in temporary files,
since libbgcode works on files.
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
    """Whether a file is binary G-code, by its first bytes."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


@contextmanager
def as_text(first: bytes, rest: IO[bytes]) -> Iterator[IO[bytes]]:
    """The text of binary G-code that begins with the bytes ``first``. Raises GcodeError."""
    with TemporaryDirectory(prefix="hframe-post-") as folder:
        binary, text = Path(folder, "binary"), Path(folder, "text")
        with binary.open("wb") as copy:
            copy.write(first)
            shutil.copyfileobj(rest, copy)
        cause = _converted("from_binary_to_ascii", binary, text, verify=True)
        if cause is not None:
            raise GcodeError(f"this is binary G-code that cannot be read: {cause}")
        with text.open("rb") as file:
            yield file


@contextmanager
def as_binary(target: IO[bytes]) -> Iterator[IO[bytes]]:
    """A file for text, which becomes binary G-code in ``target``. Raises HframeError."""
    with TemporaryDirectory(prefix="hframe-post-") as folder:
        text, binary = Path(folder, "text"), Path(folder, "binary")
        with text.open("w+b") as file:
            yield file
        cause = _converted("from_ascii_to_binary", text, binary)
        if cause is not None:
            raise HframeError(f"this cannot be written as binary G-code: {cause}")
        with binary.open("rb") as whole:
            shutil.copyfileobj(whole, target)


def _converted(function: str, source: Path, target: Path, verify: bool = False) -> str | None:
    """Converts a file; what went wrong, if anything did."""
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
            "this is binary G-code: pip install 'hframe-post[bgcode]' lets it be read and written; "
            "or turn off 'Supports binary G-code' in the slicer's printer settings and slice again"
        ) from None
    return pybgcode
