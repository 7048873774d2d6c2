"""Print times as the output tells them, in the words of the slicer, and the summary's place."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Iterable
from typing import IO

from hframe_post.writers.stream.deferred import (
    DURATION,
    SUMMARY,
    SUMMARY_ROOM,
    DeferredLine,
    Output,
)

ROOM = 24  # bytes beyond a deferred line's present length

_NUMBER = rb"\d+(?:\.\d+)?"
_CLOCK = re.compile(rb"\d+:\d\d(?::\d\d)?(?![\d:])")
_LONG_SECONDS = re.compile(rb"\d{3,}(?=s\b)")
_UNITS = re.compile(rb"(?:\d+ ?[dhms](?![a-z]) ?)+(?<! )", re.IGNORECASE)
_WORDS = re.compile(rb"\d+ hours?,? \d+ min(?:ute)?s?", re.IGNORECASE)
_MINUTES = re.compile(rb"%b(?= min)" % _NUMBER, re.IGNORECASE)
_SECONDS = re.compile(rb"%b(?= ?(?:s\b|sec|$|[\r;-]))" % _NUMBER)
_PROGRESS = re.compile(rb"([PQRS])\s*%b" % _NUMBER, re.IGNORECASE)


def write_output(
    file: IO[bytes], output: Iterable[Output], total: Callable[[], float],
    summary: Callable[[], str] = str,
) -> None:  # fmt: skip
    """Writes it all. total (the print's time, s), summary: asked when the output is used up."""
    places, elapsed = array("q"), array("d")  # of lines: a file may tell of time a million times
    place = file.tell()  # counted from here on: to ask lets other threads run, for long
    for piece in output:
        if isinstance(piece, DeferredLine):
            size = SUMMARY_ROOM if piece.summary else len(piece.line) + ROOM
            places.extend((place, size, piece.summary))
            elapsed.append(piece.elapsed)
            piece = piece.line.ljust(size) + b"\n"
        file.write(piece)
        place += len(piece)
    for k, after in enumerate(elapsed):
        place, size, is_summary = places[3 * k : 3 * k + 3]
        file.seek(place)
        if is_summary:
            told = commented(summary(), size)
        else:
            told = told_anew(DeferredLine(file.read(size - ROOM), after), total())
        file.seek(place)
        file.write(told.ljust(size)[:size])


def commented(text: str, size: int) -> bytes:
    """The lines of a text as comments, as many as have room."""
    lines, used = [], 0
    for line in text.splitlines():
        printable = "".join(c if c.isprintable() else "?" for c in line)
        told = SUMMARY.line + b" " + printable.encode()
        used += len(told) + 1
        if used > size:
            break
        lines.append(told)
    return b"\n".join(lines) or SUMMARY.line


def duration(seconds: float) -> str:
    """``1h 02m 03s``."""
    minutes, s = divmod(round(seconds), 60)
    h, m = divmod(minutes, 60)
    return f"{h}h {m:02d}m {s:02d}s" if h else f"{m}m {s:02d}s"


def told_anew(deferred: DeferredLine, total: float) -> bytes:
    """The line with print times as they are after compensation."""
    left = max(total - deferred.elapsed, 0.0)
    label = DURATION.match(deferred.line)
    if label is not None:
        head, value = deferred.line[: label.end()], deferred.line[label.end() :]
        return head + _restyled(value, left if label["left"] else total)
    percent = round(100.0 * deferred.elapsed / total) if total else 100

    def renewed(match: re.Match[bytes]) -> bytes:
        letter = match[1].upper()
        return letter + str(percent if letter in b"PQ" else math.ceil(left / 60.0)).encode()

    command, semicolon, comment = deferred.line.partition(b";")
    return _PROGRESS.sub(renewed, command) + semicolon + comment


def _restyled(value: bytes, seconds: float) -> bytes:
    """A time in place of the one that ``value`` begins with, in its style, and the rest of it."""
    hours, minutes = divmod(round(seconds / 60.0), 60)
    h, left = divmod(math.ceil(seconds), 3600)
    styles = (
        (_CLOCK, f"{h}:{left // 60:02d}:{left % 60:02d}"),
        (_WORDS, f"{hours} hours {minutes} minutes"),
        (_LONG_SECONDS, str(math.ceil(seconds))),
        (_UNITS, duration(seconds)),
        (_MINUTES, f"{seconds / 60.0:.2f}"),
        (_SECONDS, str(math.ceil(seconds))),
    )
    for style, text in styles:
        if (old := style.match(value)) is not None:
            rest = value[old.end() :]
            following = re.match(rb";\s*", rest)
            if following and (label := DURATION.match(b";" + rest[following.end() :])):
                # OrcaSlicer: the model alone, then all: what is before the model stays as long
                start = following.end() + label.end() - 1
                before = _seconds(rest[start:]) - _seconds(value)
                rest = rest[:start] + _restyled(rest[start:], seconds + max(before, 0.0))
            return text.encode() + rest
    return value


def _seconds(value: bytes) -> float:
    """A time in d, h, m and s, 0 where it is none."""
    units = {b"d": 86400.0, b"h": 3600.0, b"m": 60.0, b"s": 1.0}
    match = _UNITS.match(value)
    parts = re.findall(rb"(\d+) ?([dhms])", match[0].lower()) if match else []
    return sum(float(number) * units[unit] for number, unit in parts)
