"""Files of the component: where they are, and how they are written, compared and waited for."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any

NAME = "hframe_post"
FOLDER = ".hframe_post"  # in the folder of G-code, so that moving a file copies nothing
SETTLED_S = 1.0  # s without a change, after which a file is complete


class FailureError(Exception):
    """The reason why a file is not converted."""


class BeyondError(FailureError):
    """A conversion needs more memory or time than it may take."""


class GoneError(Exception):
    """The user has deleted, renamed or replaced the file."""


def write(path: Path, head: bytes, rest: IO[bytes] | None = None) -> None:
    """Write a file that is complete even if the power fails right after its renaming."""
    with path.open("wb") as file:
        file.write(head)
        if rest is not None:
            shutil.copyfileobj(rest, file)
        file.flush()
        os.fsync(file.fileno())


def place(new: Path, path: Path) -> None:
    """Move a file to ``path``, where it is complete as soon as it is there."""
    try:
        new.replace(path)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        near, made = path.with_name(f".{new.stem}"), new.stat()
        try:
            with new.open("rb") as file:
                write(near, b"", file)
            os.utime(near, ns=(made.st_atime_ns, made.st_mtime_ns))  # by which it is known
            near.replace(path)
        finally:
            near.unlink(missing_ok=True)
        new.unlink()


def stamp(path: Path) -> tuple[int, ...]:
    """Return numbers that change if a file is replaced or written to; empty if it is gone."""
    try:
        found = path.lstat()
    except OSError:
        return ()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def settle(path: Path) -> None:
    """Wait until nobody writes to a file any more."""
    before: tuple[int, ...] | None = None
    while (now := stamp(path)) != before:
        before = now
        time.sleep(SETTLED_S)


def gcode_files(gcodes: Path) -> Iterator[Path]:
    """Yield all files in the folder of G-code but those in FOLDER, following links once."""
    seen = set()
    for folder, folders, files in os.walk(gcodes, followlinks=True):
        here = os.path.realpath(folder)
        folders[:] = [] if here in seen else [name for name in folders if name != FOLDER]
        seen.add(here)
        yield from (Path(folder, name) for name in files)


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Wait until no other conversion runs, such as one of a Moonraker that was killed."""
    import fcntl  # which Windows has not, where setup reads this folder

    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def cause(error: Exception) -> str:
    """Return what is wrong, where, and what to do."""
    if isinstance(error, OSError) and error.strerror:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        where = Path(error.filename).parent if full and error.filename else error.filename
        advice = ". Make room there, then upload the file again" if full else ""
        return ": ".join(str(part) for part in (where, error.strerror) if part) + advice
    return str(error).removeprefix("Error: ")


# ----------------------------------------------------------------------
# What the component has measured and converted: the history that ``doctor --history`` shows.
#
# A file has a line of JSON for each event. Once it is full, it takes the place of the one before,
# so that two hold the last months. A line that a power cut has broken is skipped.

HISTORY = "history"  # a folder in FOLDER
HISTORY_BYTES = 100_000  # bytes of a file, some 600 events
MAX_TEXT_CHARACTERS = 200  # characters of a name or a reason
MAX_FIGURE = 1e11  # that a figure may be; as seconds since 1970 the year 5138
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
    texts = {"reason": event.reason[:MAX_TEXT_CHARACTERS], "name": event.name[:MAX_TEXT_CHARACTERS]}
    known = {key: value for key, value in (asdict(event) | texts).items() if value}
    with alone(folder):
        with contextlib.suppress(FileNotFoundError):
            if now.stat().st_size > HISTORY_BYTES:
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
    return str(found)[:MAX_TEXT_CHARACTERS]


def _numbers(found: Any) -> tuple[float, ...]:
    numbers = tuple(float(each) for each in found)
    if not all(0.0 <= each < MAX_FIGURE for each in numbers):
        raise ValueError("no figure of ours")
    return numbers
