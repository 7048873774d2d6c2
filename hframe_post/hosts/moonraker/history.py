"""What the component has measured and converted: the history that ``doctor --history`` shows.

A file has a line of JSON for each event. Once it is full, it takes the place of the one before, so
that two hold the last months. A line that a power cut has broken is skipped.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from .disk import alone

HISTORY = "history"  # a folder in FOLDER
FULL = 100_000  # bytes of a file, some 600 events
LONGEST_TEXT = 200  # characters of a name or a reason
GREATEST = 1e11  # that a figure may be; as seconds since 1970 the year 5138
BROKEN = (ValueError, TypeError, KeyError, AttributeError)


@dataclass(frozen=True)
class Event:
    """kind: calibration, check or conversion. at: s since 1970. reason: why nothing was changed.

    hz: the main resonance by axis, for a check before and after. name: of the converted file in
    Moonraker; rms_um, seconds: its contour error and its time, as sliced and as converted.
    """

    kind: str
    at: float = field(default_factory=time.time)
    hz: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    reason: str = ""
    name: str = ""
    rms_um: tuple[float, ...] = ()
    seconds: tuple[float, ...] = ()

    @classmethod
    def from_json(cls, line: bytes) -> Event:
        """Return the event of a line. Raises one of BROKEN."""
        found = json.loads(line)
        hz = {_text(axis): _numbers(each) for axis, each in found.get("hz", {}).items()}
        return cls(
            _text(found["kind"]), _numbers([found["at"]])[0], hz,
            _text(found.get("reason", "")), _text(found.get("name", "")),
            _numbers(found.get("rms_um", ())), _numbers(found.get("seconds", ())),
        )  # fmt: skip

    @classmethod
    def converted(cls, name: str, found: Mapping[str, Any]) -> Event:
        """Return the event of a conversion. found: its summary as JSON."""
        errors = found["contour_error_um"]
        kinds = [kind for kind in ("none", found["compensation"]) if kind in errors]
        times = found["print_time_s"]
        return cls(
            "conversion", name=name, rms_um=tuple(errors[kind]["rms"] for kind in kinds),
            seconds=(times["before"], times["after"]),
        )  # fmt: skip


def add(folder: Path, event: Event) -> None:
    """Append an event to the history in a folder. Raises OSError."""
    folder.mkdir(exist_ok=True)
    now, before = _files(folder)
    texts = {"reason": event.reason[:LONGEST_TEXT], "name": event.name[:LONGEST_TEXT]}
    known = {key: value for key, value in (asdict(event) | texts).items() if value}
    with alone(folder):
        with contextlib.suppress(FileNotFoundError):
            if now.stat().st_size > FULL:
                now.replace(before)
        with now.open("ab") as file:
            # a line of its own, also behind one that was broken
            file.write(f"\n{json.dumps(known)}\n".encode())
            file.flush()
            os.fsync(file.fileno())


def events(folder: Path) -> Iterator[Event]:
    """Yield the events in a folder, the oldest first."""
    for path in reversed(_files(folder)):
        with contextlib.suppress(FileNotFoundError):
            for line in path.read_bytes().splitlines():
                with contextlib.suppress(*BROKEN):
                    yield Event.from_json(line)


def _files(folder: Path) -> tuple[Path, Path]:
    return folder / "history.jsonl", folder / "history.before.jsonl"


def _text(found: Any) -> str:
    return str(found)[:LONGEST_TEXT]


def _numbers(found: Any) -> tuple[float, ...]:
    numbers = tuple(float(each) for each in found)
    if not all(0.0 <= each < GREATEST for each in numbers):
        raise ValueError("no figure of ours")
    return numbers
