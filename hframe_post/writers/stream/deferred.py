"""Lines that tell of the whole print: some are known only once all of it has been written."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

ELAPSED = re.compile(rb";\s*TIME_ELAPSED:")
DURATION = re.compile(  # as slicers name it: of the whole print, or what is left of it
    rb"\s*;[\s;-]*(?:(?P<left>REMAINING_TIME)|TIME|PRINT\.TIME|estimated_time\(s\)"
    rb"|(?:total )?estimated (?:print(?:ing)? )?time(?: \([a-z ]+\))?"
    rb"|model printing time|(?:estimated )?(?:print|build) time)\s*[:=]\s*(?=\d)",
    re.IGNORECASE,
)
PROGRESS = re.compile(rb"\s*M73(?!\d)[^;]*[PQRS]\s*\d", re.IGNORECASE)
SUMMARY_ROOM = 4096  # bytes


@dataclass(frozen=True, slots=True)
class DeferredLine:
    """A line that tells of the whole print's duration, ``elapsed`` s after its beginning.

    summary: it is the place of a summary of the whole conversion instead, as comments.
    """

    line: bytes
    elapsed: float
    summary: bool = False


Output = bytes | DeferredLine
SUMMARY = DeferredLine(b"; hframe-post:", 0.0, summary=True)


def carried(line: bytes, elapsed: float) -> Output:
    """A line of the file as it passes after so many s: what it tells of time waits to be known."""
    if ELAPSED.match(line) or DURATION.match(line) or PROGRESS.match(line):
        return DeferredLine(line, elapsed)
    return line + b"\n"


def later(output: Output, seconds: float) -> Output:
    """Output of a part of the print that begins so much later than the print."""
    if not isinstance(output, DeferredLine):
        return output
    elapsed = output.elapsed + seconds
    if ELAPSED.match(output.line):
        return b";TIME_ELAPSED:%.6f\n" % elapsed
    return replace(output, elapsed=elapsed)
