"""Lines about the whole print, known only at its end: print times in the slicer's words, summary.

They are written with blanks to spare, and again once the print's time is known.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import IO

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.native.digits import progress_lines
from hframe_post.stream.marks import recent

SUMMARY_BYTES = 4096  # bytes: the summary's length is not known when the body is written after it
REWRITTEN_BYTES = 1 << 18  # bytes of a file in which lines are written again together
ROOM_BYTES = 4  # bytes beyond a deferred line's present length, for numbers with more digits

# comments that say a time, in slicers' words: how much has passed, is left, or all of it
_COMMENT = re.compile(
    rb"\s*;[\s;-]*(?:(?P<gone>TIME_ELAPSED)|(?P<left>REMAINING_TIME)|TIME|PRINT\.TIME"
    rb"|estimated(?:_print)?_time(?:_s|\(s\))"
    rb"|(?:total |model |estimated |calculated-during-export )*(?:print(?:ing)?|build)?[ _]?time"
    rb"(?: \([a-z ]+\))?)\s*[:=]\s*(?=\d)",
    re.IGNORECASE,
)
_MESSAGE = re.compile(rb"\s*M11[78][^;]*?\b(?P<left>time left|remaining) +(?=\d)", re.IGNORECASE)
_PROGRESS = re.compile(rb"\s*M73(?!\d)[^;]*?[RS]\s*(?=\d)", re.IGNORECASE)
_LEFT = re.compile(rb"([RS])(\s*)(\d+(?:\.\d+)?)(?=[^;]*)", re.IGNORECASE)  # minutes, of M73
_HEAD = re.compile(
    rb"(?:[ \t\r]*(?:;[^\n]*|M10086\b[^\n]*)?\n)*"
)  # M10086: an MKS screen's preview

_NUMBER = rb"\d+(?:\.\d+)?"
_CLOCK = re.compile(rb"(\d+):(\d\d)(?::(\d\d))?(?![\d:]|\s*[dhms])")
_UNIT = rb"(?:d(?:ays?)?|h(?:(?:ou)?rs?)?|m(?:in(?:ute)?s?)?|s(?:ec(?:ond)?s?)?)(?![a-z])"
_UNITS = re.compile(
    rb"%b ?%b(?:[ ,:]*(?:and )?%b ?%b)*" % (_NUMBER, _UNIT, _NUMBER, _UNIT), re.IGNORECASE
)
_SECONDS = re.compile(_NUMBER)
_IN_UNITS = re.compile(rb"(%b)( ?)(%b)" % (_NUMBER, _UNIT), re.IGNORECASE)
_CORRUPTED = re.compile(rb"\d{20}")  # no time has as many digits
_PER_UNIT = {b"d": 86400, b"h": 3600, b"m": 60, b"s": 1}


@dataclass(frozen=True, slots=True)
class Deferred:
    """Lines, k of which say the duration of the whole print or a part of it.

    at (k, 2): where each of these begins and ends in the text, before its line feed; elapsed (k,):
    s after the beginning of the print. summary: the only line is the place for a summary of the
    whole conversion instead, as comments.
    """

    text: bytes
    at: Integers
    elapsed: Array
    summary: bool = False

    @classmethod
    def from_line(cls, line: bytes, elapsed: float, summary: bool = False) -> Deferred:
        """Return a single line."""
        return cls(line + b"\n", np.array([[0, len(line)]]), np.array([elapsed]), summary)


Output = bytes | Deferred
COMMENT = b"; hframe-post:"
SUMMARY = Deferred.from_line(COMMENT, 0.0, summary=True)


@recent
def says_time(line: bytes) -> bool:
    return bool(_COMMENT.match(line) or _PROGRESS.match(line) or _MESSAGE.match(line))


def later(output: Output, seconds: float) -> Output:
    """Return the output of a part of the print that begins this long after the print."""
    if not isinstance(output, Deferred):
        return output
    return replace(output, elapsed=output.elapsed + seconds)


def after_head(output: Iterable[Output], *added: Output) -> Iterator[Output]:
    """Yield the output with more behind the comments that it begins with.

    Screens look for a preview in the first bytes of a file, or at a fixed place.
    """
    output = iter(output)
    for piece in output:
        text = piece.text if isinstance(piece, Deferred) else piece
        head = _HEAD.match(text)
        if head is not None and head.end() == len(text):
            yield piece
            continue
        if head is not None and head.end():
            first, piece = _cut(piece, head.end())
            yield first
        yield from added
        yield piece
        yield from output
        return
    yield from added


def _cut(output: Output, place: int) -> tuple[Output, Output]:
    """Return the output before and from a place of its text on, where a line begins."""
    if not isinstance(output, Deferred):
        return output[:place], output[place:]
    text, early = output.text, output.at[:, 0] < place
    return (
        Deferred(text[:place], output.at[early], output.elapsed[early]),
        Deferred(text[place:], output.at[~early] - place, output.elapsed[~early]),
    )


def write_output(
    file: IO[bytes], output: Iterable[Output], times: Callable[[], tuple[float, float]],
    summary: Callable[[], str] = str,
) -> None:  # fmt: skip
    """Write the output.

    times: of the print as sliced and as converted, s. They and the summary are known at its end.
    """
    deferred, summaries = list[tuple[Integers, Array]](), list[int]()
    place = file.tell()  # counted from here on: asking the file each time would be slow
    for piece in output:
        if isinstance(piece, Deferred):
            room = SUMMARY_BYTES - len(COMMENT) if piece.summary else ROOM_BYTES
            if piece.summary:
                summaries.append(place)
            else:
                moved = place + room * np.arange(len(piece.at))[:, None]
                deferred.append((piece.at + moved, piece.elapsed))
            ends = [0, *piece.at[:, 1].tolist(), len(piece.text)]
            piece = (b" " * room).join([piece.text[a:b] for a, b in pairwise(ends)])
        file.write(piece)
        place += len(piece)
    before_and_after = times()
    for place in summaries:
        file.seek(place)
        file.write(commented(summary(), SUMMARY_BYTES).ljust(SUMMARY_BYTES)[:SUMMARY_BYTES])
    if deferred:
        at, elapsed = (np.concatenate(each) for each in zip(*deferred, strict=True))
        _write_times(file, at, elapsed, *before_and_after)


def _write_times(
    file: IO[bytes], at: Integers, elapsed: Array, before: float, after: float
) -> None:
    """Change the times of lines at places (k, 2) of a file; ROOM_BYTES blanks follow each."""
    begun = 0
    while begun < len(at):
        first = int(at[begun, 0])
        end = int(at[:, 0].searchsorted(first + REWRITTEN_BYTES))
        rows = at[begun:end] - first
        file.seek(first)
        text = np.frombuffer(file.read(int(rows[-1, 1]) + ROOM_BYTES), np.uint8).copy()
        for k in progress_lines(text, rows, elapsed[begun:end], before, after, ROOM_BYTES).tolist():
            start, stop = rows[k].tolist()
            size = stop - start + ROOM_BYTES
            line = with_times(text[start:stop].tobytes(), float(elapsed[begun + k]), before, after)
            text[start : start + size] = np.frombuffer(line.ljust(size)[:size], np.uint8)
        file.seek(first)
        file.write(text.tobytes())
        begun = end


def commented(text: str, size: int) -> bytes:
    """Return the lines of a text as comments, as many as fit into size bytes."""
    comments = b""
    for line in text.splitlines():
        printable = "".join(c if c.isprintable() else "?" for c in line)
        longer = comments + COMMENT + b" " + printable.encode() + b"\n"
        if len(longer) > size:
            break
        comments = longer
    return comments.rstrip(b"\n") or COMMENT


def duration(seconds: float) -> str:
    """Return ``1h 02m 03s``."""
    minutes, s = divmod(round(seconds), 60)
    h, m = divmod(minutes, 60)
    return f"{h}h {m:02d}m {s:02d}s" if h else f"{m}m {s:02d}s"


def with_times(line: bytes, elapsed: float, before: float, after: float) -> bytes:
    """Return the line with its times changed by as much as conversion changes the print's.

    elapsed: s after the beginning of the print. before, after: its duration as sliced and as
    converted, s. What only the slicer knows of, such as tool changes, stays in them.
    """
    share = elapsed / after if after else 0.0
    change = {"all": after - before, "gone": (after - before) * share}
    change["left"] = change["all"] - change["gone"]
    faster = min(after / before, 1.0) if before else 1.0

    def changed(kind: str, seconds: float) -> float:
        # a slicer may expect much less
        return max(seconds + change.get(kind, change["left"]), faster * seconds)

    return _changed(line, changed, before)


def times_of(line: bytes) -> dict[str, float]:
    """Return the times (s) that a line says: "gone", "left", "all", or those of M73 by letter."""
    found = dict[str, float]()
    if not says_time(line):
        return found

    def noted(kind: str, seconds: float) -> float:
        found[kind] = seconds
        return seconds

    _changed(line, noted, 0.0)
    return found


def _changed(line: bytes, changed: Callable[[str, float], float], expected: float) -> bytes:
    """Return the line with each time changed, given its kind, see ``times_of``, and seconds."""
    if _CORRUPTED.search(line):
        return line
    if _PROGRESS.match(line):

        def minutes(match: re.Match[bytes]) -> bytes:
            seconds = changed(match[1].decode().upper(), 60.0 * float(match[3]))
            return match[1] + match[2] + _rounded(seconds, 60, match[3])

        command, semicolon, comment = line.partition(b";")
        return _LEFT.sub(minutes, command) + semicolon + comment
    at = 0
    while label := (_COMMENT.match(line, at) or _MESSAGE.match(line, at)):
        kind = label.lastgroup or "all"
        end, text = _restyled(line[label.end() :], partial(changed, kind), expected)
        at, line = label.end() + len(text), line[: label.end()] + text + line[label.end() + end :]
    return line


def _restyled(
    value: bytes, changed: Callable[[float], float], expected: float
) -> tuple[int, bytes]:
    """Change the time that value begins with, and keep its form.

    Returns how many bytes it has and those that replace them. expected: s; tells m:ss from h:mm.
    """
    if clock := _CLOCK.match(value):
        units = [3600, 60, 1] if clock[3] else [3600, 60]
        parts = [part for part in clock.groups() if part]
        if not clock[3]:
            minutes = 60.0 * int(parts[0]) + int(parts[1])
            if abs(math.log(max(expected, 1.0) / max(minutes, 1.0))) < math.log(60.0) / 2.0:
                units = [60, 1]
        texts = _spread(parts, units, changed)
        return clock.end(), b":".join([texts[0], *(text.rjust(2, b"0") for text in texts[1:])])
    if found := _UNITS.match(value):
        named = _IN_UNITS.findall(found[0])
        units = [_PER_UNIT[unit[:1].lower()] for *_, unit in named]
        numbers = iter(_spread([number for number, *_ in named], units, changed))
        return found.end(), _IN_UNITS.sub(lambda m: next(numbers) + m[2] + m[3], found[0])
    if (seconds := _SECONDS.match(value)) is None:
        return 0, b""
    return seconds.end(), _rounded(changed(float(seconds[0])), 1, seconds[0])


def _spread(
    parts: Sequence[bytes], units: Sequence[int], changed: Callable[[float], float]
) -> list[bytes]:
    """Return the changed sum of numbers of units as such numbers; all but the last are whole."""
    total = sum(float(part) * unit for part, unit in zip(parts, units, strict=True))
    step = units[-1] / 10 ** len(parts[-1].partition(b".")[2])
    left, texts = round(changed(total) / step) * step, []
    for part, unit in zip(parts[:-1], units[:-1], strict=True):
        count = int((left + 1e-9 * unit) // unit)
        left -= count * unit
        texts.append(_padded(b"%d" % count, part))
    return [*texts, _rounded(left, units[-1], parts[-1])]


def _rounded(seconds: float, unit: int, like: bytes) -> bytes:
    """Return seconds in a unit with as many decimals as ``like``, and its leading zeros."""
    decimals = len(like.partition(b".")[2])
    rounded = round(max(seconds, 0.0) / unit * 10.0**decimals) / 10.0**decimals
    return _padded(f"{rounded:.{decimals}f}".encode(), like)


def _padded(text: bytes, like: bytes) -> bytes:
    return text.rjust(len(like), b"0") if like[:1] == b"0" and like[1:2].isdigit() else text
