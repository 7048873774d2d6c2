"""Which recordings a folder holds, and of which motion each of them is.

files → commands of sweeps, recordings → recordings with their motions
      → without copies and second sensors → sessions
"""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from types import MappingProxyType

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.errors import HframeError, IdentificationError
from hframe_post.identification.recordings.accelerometer import Recording, from_table
from hframe_post.identification.recordings.formats import (
    is_command,
    read_command,
    read_tables,
    unpacked,
)
from hframe_post.identification.recordings.names import (
    ENDINGS,
    RecordingName,
    day_of,
    parsed,
    stem,
)
from hframe_post.identification.verdict import CLOCK_DRIFT

SUFFIXES = (".csv", ".csv.gz", ".csv.xz", ".csv.zst", ".stdata")
DEPTH, MOST_FILES = 3, 500  # of folders in folders; of files
STROKES, CHECK = "measure", "check"  # how the names of their runs begin
WAITING = 120.0  # s before and after the motion, in a recording that was started by hand
EXPLICIT = "or name it with its command: 'hframe-post identify --nozzle COMMAND RECORDING'"


@dataclass(frozen=True, slots=True)
class RunMotion:
    """The motion of a run: x and y (m, 2) in mm every 1 ms. run: the last word of its name."""

    path: Path
    run: str
    motion: Array

    @classmethod
    def read(cls, path: Path) -> RunMotion:
        """Return the command in a file. Raises OSError and IdentificationError."""
        return cls(path, ENDINGS.sub("", path.name).rpartition(".")[2], read_command(path))

    @property
    def direction(self) -> tuple[float, float, float] | None:
        """Return a unit vector along the one axis that moves; None if both or none move."""
        x, y = (float(width > 0.0) for width in np.ptp(self.motion, axis=0))
        return None if x == y else (x, y, 0.0)

    @property
    def kind(self) -> str:
        """Return the command that wrote it, if Klipper records it and so tells its start."""
        return next((kind for kind in (STROKES, CHECK) if self.run.startswith(kind)), "")

    def lasts_as_long_as(self, recording: Recording) -> bool:
        """Return whether the recording covers the motion, and little more."""
        moving = np.flatnonzero((np.diff(self.motion, axis=0) != 0.0).any(axis=1))
        if not moving.size:
            return False
        recorded = float(recording.t[-1] - recording.t[0])
        least, most = TS * float(np.ptp(moving)), TS * len(self.motion) + WAITING
        return least * (1.0 - CLOCK_DRIFT) <= recorded <= most * (1.0 + CLOCK_DRIFT)


@dataclass(frozen=True, slots=True)
class Measurement:
    """A recording in a file.

    label: the file, in the folder given, and which of several. digest: of the samples. command:
    None for a test of resonances, whose motion follows from printer.cfg. session: 1, or more for
    recordings that repeat the test of an earlier one.
    """

    label: str
    path: Path
    recording: Recording
    name: RecordingName
    digest: str
    command: RunMotion | None = None
    session: int = 1

    @property
    def direction(self) -> tuple[float, float, float] | None:
        return self.command.direction if self.command else self.name.direction

    @property
    def day(self) -> date:
        """Return the day on which it was made. Raises OSError."""
        return day_of(self.name, self.path)

    @property
    def test(self) -> tuple[object, ...]:
        """Return what the recordings of a repeated test share."""
        return (self.command.run if self.command else self.name.point, self.direction)


@dataclass(frozen=True, slots=True)
class Aside:
    """A file or measurement that is not used, and why."""

    label: str
    reason: str


def contents(
    paths: Sequence[Path], columns: Sequence[str] | None = None,
    chips: Mapping[str, str] = MappingProxyType({}), pairs: Sequence[tuple[Path, Path]] = (),
) -> tuple[list[Measurement], list[Aside]]:  # fmt: skip
    """Return the recordings in files and folders, each with its motion, and what is left aside.

    columns: names of time, x, y, z in files that do not say it. chips: by x and y, the sensor to
    use where several recorded tests along one direction. pairs: commands and their recordings, as
    the owner knows them. Raises OSError if a folder or a command cannot be read, and
    IdentificationError if no file is of a kind that recordings have.
    """
    files = files_in(paths)
    if not files and not pairs:
        raise IdentificationError(
            f"{', '.join(map(str, paths))}: no recordings here. They have names such as "
            "raw_data_x_….csv, adxl345-….csv or ….stdata. To record with Klipper, print what "
            "'hframe-post measure' writes, or run TEST_RESONANCES AXIS=X OUTPUT=raw_data, and "
            "AXIS=Y; it writes to /tmp of its host. With Marlin, print what 'hframe-post measure' "
            "writes"
        )
    read = list[RunMotion | Measurement | Aside]()
    for path, label in files.items():
        other = parsed(path.name).other
        read += [Aside(label, other)] if other else _read(path, label, columns)
    commands = [each for each in read if isinstance(each, RunMotion)]
    found: list[Measurement | Aside] = [each for each in read if isinstance(each, Aside)]
    found += [_with_motion(each, commands) for each in read if isinstance(each, Measurement)]
    for command, path in pairs:
        motion = RunMotion.read(command)
        for each in _read(path, path.name, columns):
            if isinstance(each, Measurement):
                found.append(replace(each, command=motion))
            elif isinstance(each, Aside):
                found.append(each)
    found = list(_without_second_sensors(list(_without_copies(found)), chips))
    measurements = [each for each in found if isinstance(each, Measurement)]
    return list(_in_sessions(measurements)), [each for each in found if isinstance(each, Aside)]


def files_in(paths: Sequence[Path]) -> dict[Path, str]:
    """Return the files given, and those in the folders given that may be recordings.

    Each has a label: its name, or its path within the folder. Raises OSError if a folder cannot be
    read, and IdentificationError.
    """
    files: dict[Path, str] = {}
    for path in paths:
        if not path.is_dir():
            files[path] = path.name
            continue
        for folder, inner, names in os.walk(path, onerror=_raise):
            deep = len(Path(folder).relative_to(path).parts) >= DEPTH
            inner[:] = [] if deep else sorted(name for name in inner if not name.startswith("."))
            chosen = [n for n in names if n.lower().endswith(SUFFIXES) and not n.startswith(".")]
            inside = [Path(folder) / name for name in sorted(chosen)]
            files |= {file: str(file.relative_to(path)) for file in inside}
    if len(files) > MOST_FILES:
        raise IdentificationError(
            f"{paths[0]}: {len(files)} files are too many. Give a folder with the recordings of "
            "one printer"
        )
    return files


def _raise(error: OSError) -> None:
    raise error


def _read(
    path: Path, label: str, columns: Sequence[str] | None
) -> Iterator[RunMotion | Measurement | Aside]:
    """Yield the command or the recordings in a file, or why it has none that can be used."""
    by_file = parsed(path.name)
    try:
        content = unpacked(path)
        if is_command(content):
            yield RunMotion.read(path)
        tables = [] if is_command(content) else read_tables(path, content, columns)
    except (HframeError, OSError) as error:
        yield Aside(label, _reason(path, error))
        return
    for table in tables:
        which = f"{label}: {table.name}" if len(tables) > 1 else label
        name = parsed(table.name) | by_file if table.name else by_file
        try:
            recording = from_table(path, table)
        except HframeError as error:
            yield Aside(which, _reason(path, error))
            continue
        digest = hashlib.sha256(table.values.tobytes()).hexdigest()[:16]
        yield Measurement(which, path, recording, name, digest)


def _reason(path: Path, error: Exception) -> str:
    """Return why a file is not used, without its name."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return str(error).removeprefix(str(path)).removeprefix(":").strip().removeprefix("is ")


def _with_motion(one: Measurement, commands: Sequence[RunMotion]) -> Measurement | Aside:
    """Return a recording with its command, if it is not one of a test of resonances."""
    name = one.name
    if name.other:
        return Aside(one.label, name.other)
    if not name.certain and (found := _of_command(one, commands)) is not None:
        return found
    if name.direction is None:
        unknown = "neither its name nor a command next to it shows which axis moved"
        return Aside(one.label, f"{unknown}. Rename it, as raw_data_x_1.csv; {EXPLICIT}")
    if abs(name.direction[2]) > 0.0:
        return Aside(one.label, "a test in which z moves, which is not compensated")
    return replace(one, recording=replace(one.recording, started=False))


def _of_command(one: Measurement, commands: Sequence[RunMotion]) -> Measurement | Aside | None:
    """Return a recording with the command that its name ends with, or else of the same axis.

    A command in the same folder goes before others. None if there is none.
    """
    own, axis = stem(one.path.name), one.name.direction
    named = [command for command in commands if own.endswith(command.run)]
    possible = named or [command for command in commands if axis and command.direction == axis]
    fitting = [command for command in possible if command.lasts_as_long_as(one.recording)]
    if not fitting and named:
        lasts, needed = float(np.ptp(one.recording.t)), TS * len(named[0].motion)
        cause = f"it lasts {lasts:.1f} s, but its motion, {named[0].path.name}, {needed:.1f} s"
        return Aside(one.label, f"{cause}: it was cut off, or is of another run")
    if not fitting:
        return None

    def rank(command: RunMotion) -> tuple[int, bool]:
        return len(command.run) if named else 0, command.path.parent == one.path.parent

    best = [command for command in fitting if rank(command) == max(map(rank, fitting))]
    if not all(np.array_equal(c.motion, best[0].motion) for c in best):
        which = ", ".join(c.path.name for c in best[:4])
        return Aside(one.label, f"several commands may be its motion: {which}; {EXPLICIT}")
    if best[0].direction is None and not best[0].kind:
        return Aside(one.label, f"{best[0].path.name} moves both axes; only one can be measured")
    words = own.removesuffix(best[0].run).rstrip("-_.") if named else ""
    chip = words.replace("-", "_") or one.name.chip
    return replace(one, command=best[0], name=replace(one.name, chip=chip))


def _without_copies(found: list[Measurement | Aside]) -> Iterator[Measurement | Aside]:
    first: dict[str, Measurement] = {}
    for one in found:
        if isinstance(one, Measurement) and first.setdefault(one.digest, one) is not one:
            yield Aside(one.label, f"a copy of {first[one.digest].label}")
        else:
            yield one


def _without_second_sensors(
    found: Sequence[Measurement | Aside], chips: Mapping[str, str]
) -> Iterator[Measurement | Aside]:
    """Yield what one sensor recorded of directions of which several sensors are named."""
    known = [one for one in found if isinstance(one, Measurement)]
    counts = "printer.cfg or the shorter name says which one counts"
    for one in found:
        if isinstance(one, Aside) or _counts(one, known, chips):
            yield one
        else:
            yield Aside(one.label, f"of a second sensor, {one.name.chip}; {counts}")


def _counts(one: Measurement, known: Sequence[Measurement], chips: Mapping[str, str]) -> bool:
    if not one.name.chip:
        return True
    rivals = {each.name.chip for each in known if each.direction == one.direction} - {""}
    section = chips.get("x" if one.direction and one.direction[0] else "y", "")
    wanted = {chip for chip in rivals if f"_{section}".endswith(f"_{chip}")}
    return one.name.chip == max(wanted or {min(rivals, key=len)}, key=len)


def _in_sessions(found: Sequence[Measurement]) -> Iterator[Measurement]:
    counts: Counter[tuple[object, ...]] = Counter()
    for one in sorted(found, key=lambda each: (each.name.date, each.label)):
        counts[one.test] += 1
        yield replace(one, session=counts[one.test])
