"""The day on which a recording was made: by its name, its head, or else the time of its file.

A copied or downloaded file has a new time, so that comes last. Programs write the day into the
name of the file (Klipper, Shake&Tune until 2024), the name of the measurement in it (.stdata), or
comments and headers above the first sample. gzip keeps the time of the file that it packed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.names import days_in
from hframe_post.identification.recordings.packed import GZIP, unpacked

EARLIEST = date(2010, 1, 1)  # no accelerometer was recorded on a printer before
HEAD = 1 << 12  # bytes in which a date is looked for
SAMPLE = re.compile(r"[-+.\d\s,;]*\d[-+.\deE\s,;]*")  # a line of numbers
JSON_NAME = re.compile(r'"name"\s*:\s*"([^"]*)"')


def recorded_on(path: Path) -> date:
    """Return the day on which the recording in a file was made. Raises OSError."""
    written = datetime.fromtimestamp(path.stat().st_mtime, UTC).date()
    tomorrow = datetime.now(UTC).date() + timedelta(days=1)  # somewhere it is tomorrow already
    named = (*days_in(path.name), *_days_in_head(path))
    return next((day for day in named if EARLIEST <= day <= tomorrow), written)


def _days_in_head(path: Path) -> Iterator[date]:
    try:
        text = unpacked(path)[:HEAD].decode("latin-1")
    except IdentificationError:  # damaged
        text = ""
    if text.startswith("{"):
        text = "\n".join(JSON_NAME.findall(text))
    for line in text.splitlines():
        if SAMPLE.fullmatch(line):
            break
        yield from days_in(line)
    with path.open("rb") as file:
        start = file.read(8)
    if start.startswith(GZIP) and (packed := int.from_bytes(start[4:8], "little")):
        yield datetime.fromtimestamp(packed, UTC).date()
