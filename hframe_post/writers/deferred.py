"""Lines of the file that tell of time: told anew, some only once the whole print is known."""

from __future__ import annotations

import re
from dataclasses import dataclass

ELAPSED = re.compile(rb";\s*TIME_ELAPSED:")
TOTAL = re.compile(rb";\s*TIME:\s*\d|[Mm]73\s|; estimated printing time \(normal mode\) =")


@dataclass(frozen=True, slots=True)
class DeferredLine:
    """A line that tells of the whole print's duration, which is known only at the end."""

    line: bytes
    elapsed: float


Output = bytes | DeferredLine


def carried(line: bytes, elapsed: float) -> Output:
    """A line of the file as it passes after so many s of print: what it tells of time is new."""
    if ELAPSED.match(line):
        return b";TIME_ELAPSED:%.6f\n" % elapsed
    if TOTAL.match(line):
        return DeferredLine(line, elapsed)
    return line + b"\n"
