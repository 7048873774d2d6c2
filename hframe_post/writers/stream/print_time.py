"""Lines about the whole print, known only at its end: print times in the slicer's words, summary.

They are written with blanks to spare, and again once the print's time is known.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import IO

ELAPSED = re.compile(rb";\s*TIME_ELAPSED:")
DURATION = re.compile(  # in slicers' words: of the whole print, or what is left of it
    rb"\s*;[\s;-]*(?:(?P<left>REMAINING_TIME)|TIME|PRINT\.TIME|estimated_time\(s\)"
    rb"|(?:total )?estimated (?:print(?:ing)? )?time(?: \([a-z ]+\))?"
    rb"|model printing time|(?:estimated )?(?:print|build) time)\s*[:=]\s*(?=\d)",
    re.IGNORECASE,
)
PROGRESS = re.compile(rb"\s*M73(?!\d)[^;]*[PQRS]\s*\d", re.IGNORECASE)
SUMMARY_ROOM = 4096  # bytes: the summary's length is not known when the body is written after it
ROOM = 24  # bytes beyond a deferred line's present length

_NUMBER = rb"\d+(?:\.\d+)?"
_CLOCK = re.compile(rb"\d+:\d\d(?::\d\d)?(?![\d:])")
_LONG_SECONDS = re.compile(rb"\d{3,}(?=s\b)")
_UNITS = re.compile(rb"(?:\d+ ?[dhms](?![a-z]) ?)+(?<! )", re.IGNORECASE)
_WORDS = re.compile(rb"\d+ hours?,? \d+ min(?:ute)?s?", re.IGNORECASE)
_MINUTES = re.compile(rb"%b(?= min)" % _NUMBER, re.IGNORECASE)
_SECONDS = re.compile(rb"%b(?= ?(?:s\b|sec|$|[\r;-]))" % _NUMBER)
_PROGRESS = re.compile(rb"([PQRS])\s*%b" % _NUMBER, re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class DeferredLine:
    """A line with the whole print's duration, ``elapsed`` s after its beginning.

    summary: the place for a summary of the whole conversion instead, as comments.
    """

    line: bytes
    elapsed: float
    summary: bool = False


Output = bytes | DeferredLine
SUMMARY = DeferredLine(b"; hframe-post:", 0.0, summary=True)


def passed_on(line: bytes, elapsed: float) -> Output:
    """Return a line of the file as output, deferred if it depends on the print's time."""
    if ELAPSED.match(line) or DURATION.match(line) or PROGRESS.match(line):
        return DeferredLine(line, elapsed)
    return line + b"\n"


def later(output: Output, seconds: float) -> Output:
    """Return the output of a part of the print that begins this long after the print."""
    if not isinstance(output, DeferredLine):
        return output
    elapsed = output.elapsed + seconds
    if ELAPSED.match(output.line):
        return b";TIME_ELAPSED:%.6f\n" % elapsed
    return replace(output, elapsed=elapsed)


def write_output(
    file: IO[bytes], output: Iterable[Output], total: Callable[[], float],
    summary: Callable[[], str] = str,
) -> None:  # fmt: skip
    """Write the output. total (the print's time, s) and summary are called at its end."""
    places, elapsed = array("q"), array("d")  # a file may have a million deferred lines
    place = file.tell()  # counted from here on: asking the file each time would be slow
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
            text = commented(summary(), size)
        else:
            text = with_times(DeferredLine(file.read(size - ROOM), after), total())
        file.seek(place)
        file.write(text.ljust(size)[:size])


def commented(text: str, size: int) -> bytes:
    """Return the lines of a text as comments, as many as fit into size bytes."""
    comments = b""
    for line in text.splitlines():
        printable = "".join(c if c.isprintable() else "?" for c in line)
        longer = comments + SUMMARY.line + b" " + printable.encode() + b"\n"
        if len(longer) > size:
            break
        comments = longer
    return comments.rstrip(b"\n") or SUMMARY.line


def duration(seconds: float) -> str:
    """Return ``1h 02m 03s``."""
    minutes, s = divmod(round(seconds), 60)
    h, m = divmod(minutes, 60)
    return f"{h}h {m:02d}m {s:02d}s" if h else f"{m}m {s:02d}s"


def with_times(deferred: DeferredLine, total: float) -> bytes:
    """Return the line with print times for a print that takes total seconds."""
    left = max(total - deferred.elapsed, 0.0)
    label = DURATION.match(deferred.line)
    if label is not None:
        head, value = deferred.line[: label.end()], deferred.line[label.end() :]
        return head + _restyled(value, left if label["left"] else total)
    percent = round(100.0 * deferred.elapsed / total) if total else 100

    def progress(match: re.Match[bytes]) -> bytes:
        letter = match[1].upper()
        return letter + str(percent if letter in b"PQ" else math.ceil(left / 60.0)).encode()

    command, semicolon, comment = deferred.line.partition(b";")
    return _PROGRESS.sub(progress, command) + semicolon + comment


def _restyled(value: bytes, seconds: float) -> bytes:
    """Return value with the time that it begins with replaced, in the same style."""
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
    units = {b"d": 86400.0, b"h": 3600.0, b"m": 60.0, b"s": 1.0}
    match = _UNITS.match(value)
    parts = re.findall(rb"(\d+) ?([dhms])", match[0].lower()) if match else []
    return sum(float(number) * units[unit] for number, unit in parts)
