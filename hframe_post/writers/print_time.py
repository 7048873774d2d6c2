"""Print times as the output tells them: lines that are known only once all is written."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from typing import IO

from hframe_post.writers.deferred import DeferredLine, Output

ROOM = 24  # bytes beyond a deferred line's present length


def write_output(file: IO[bytes], output: Iterable[Output], total: Callable[[], float]) -> None:
    """Writes it all. total: the print's time (s), asked when the output is used up."""
    deferred: list[tuple[int, int, DeferredLine]] = []
    for piece in output:
        if isinstance(piece, DeferredLine):
            size = len(piece.line) + ROOM
            deferred.append((file.tell(), size, piece))
            file.write(b" " * size + b"\n")
        else:
            file.write(piece)
    for offset, size, line in deferred:
        file.seek(offset)
        file.write(told_anew(line, total()).ljust(size)[:size])


def duration(seconds: float) -> str:
    """``1h 02m 03s``."""
    minutes, s = divmod(round(seconds), 60)
    h, m = divmod(minutes, 60)
    return f"{h}h {m:02d}m {s:02d}s" if h else f"{m}m {s:02d}s"


_M73 = re.compile(rb"([PQRSC])\s*(\d+)", re.IGNORECASE)


def told_anew(deferred: DeferredLine, total: float) -> bytes:
    """The line with print times as they are after compensation."""
    left = max(total - deferred.elapsed, 0.0)
    if deferred.line[:1] == b";":
        head, mark, _ = deferred.line.partition(b"=" if b"=" in deferred.line else b":")
        told = f" {duration(total)}" if mark == b"=" else str(math.ceil(total))
        return head + mark + told.encode()
    percent = round(100.0 * deferred.elapsed / total) if total else 100

    def renewed(match: re.Match[bytes]) -> bytes:
        letter = match[1].upper()
        value = percent if letter in b"PQ" else math.ceil(left / 60.0)
        return match[0] if letter == b"C" else letter + str(value).encode()

    head, semicolon, comment = deferred.line.partition(b";")
    return _M73.sub(renewed, head) + semicolon + comment
