"""Comparison of two G-code files: the same lines, and the same motion in place and time.

Between two lines that are not moves, each file is a path in nominal time. The paths are the same if
every vertex of either is within the tolerance of the other path, at most ``slack`` earlier or
later. So the same motion cut into other segments is still the same motion.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import GcodeError, one_line
from hframe_post.firmware.dialect import Dialect
from hframe_post.gcode.commands import Line, command, numbers
from hframe_post.gcode.state import AXES
from hframe_post.studies.motion_file import MoveSection, sections

MAX_DRIFT = 1e-4  # of the time of all motion, to which rounded feed rates may add up
VERTICES_AT_ONCE = 1 << 16

_PRINT_TIME = re.compile(
    rb";\s*TIME(_ELAPSED)?:|[Mm]73\s|; estimated (printing|first layer printing) time"
)
_NUMBER = re.compile(rb"[\d.]+")


@dataclass(frozen=True, slots=True)
class Tolerance:
    """The largest distance between two paths: mm in place and in filament, s in time."""

    place: float = 1e-3
    slack: float = 1e-3


@dataclass(frozen=True, slots=True)
class Difference:
    """The first difference. a, b: source lines, None past the end; texts: what is there."""

    what: str
    a: int | None
    a_text: str
    b: int | None
    b_text: str


@dataclass(frozen=True, slots=True)
class Comparison:
    """The result of a comparison, up to the first difference.

    moves: their number in each file. other_lines: the number of lines that are not moves.
    distance: largest distance of a vertex from the other path, mm. duration: nominal time of the
    motion in each file, s.
    """

    moves: tuple[int, int]
    other_lines: int
    distance: float
    duration: tuple[float, float]
    difference: Difference | None

    @property
    def same(self) -> bool:
        return self.difference is None

    def as_json(self) -> dict[str, Any]:
        return {
            "same": self.same,
            "moves": list(self.moves),
            "other_lines": self.other_lines,
            "apart_um": round(self.distance * 1e3, 4),
            "motion_s": [round(seconds, 6) for seconds in self.duration],
            "first_difference": asdict(self.difference) if self.difference else None,
        }

    def as_text(self) -> str:
        counts = (
            f"{self.moves[0]} and {self.moves[1]} moves, {self.other_lines} other lines, "
            f"{self.duration[0]:.3f} and {self.duration[1]:.3f} s of motion"
        )
        if self.difference is None:
            return f"same: at most {self.distance * 1e3:.3g} µm apart; {counts}"
        first = self.difference
        return "\n".join(
            (
                f"different: {first.what}",
                f"  a, {_where(first.a)}: {first.a_text}",
                f"  b, {_where(first.b)}: {first.b_text}",
                f"the same up to there: {counts}",
            )
        )


def _where(line: int | None) -> str:
    return "end of file" if line is None else f"line {line}"


def compare(
    a: Iterable[bytes], b: Iterable[bytes], dialect: Dialect, tolerance: Tolerance | None = None
) -> Comparison:
    """Compare two files up to the first difference, streaming. Raises GcodeError.

    The numbers in lines about print time may differ, and those of G92 within the tolerance.
    """
    tolerance = tolerance or Tolerance()
    moves, duration, largest, other_lines = [0, 0], [0.0, 0.0], 0.0, 0
    pairs = zip(_sections(a, dialect, "a"), _sections(b, dialect, "b"), strict=False)
    for first, second in pairs:  # a file's last section has no closing line: both end together
        difference = _closing(first, second, tolerance)
        if difference is None:
            distance, difference = _motion(first, second, tolerance)
            largest = max(largest, distance)
            for k, section in enumerate((first, second)):
                moves[k] += len(section.line)
                duration[k] += float(section.time[-1])
        difference = difference or _drift(first, second, duration, tolerance)
        if difference is not None:
            break
        other_lines += first.closing is not None
    else:
        difference = None
    return Comparison(
        (moves[0], moves[1]), other_lines, largest, (duration[0], duration[1]), difference
    )


def _sections(lines: Iterable[bytes], dialect: Dialect, name: str) -> Iterator[MoveSection]:
    try:
        yield from sections(lines, dialect)
    except GcodeError as error:
        where = "" if error.line is None else f"line {error.line}: "
        raise GcodeError(f"{name}: {where}{error.cause}", None, error.text) from None


# ---------------------------------------------------------------------- other lines


def _closing(a: MoveSection, b: MoveSection, tolerance: Tolerance) -> Difference | None:
    first, second = a.closing, b.closing
    if first is second is None:
        return None
    if first is not None and second is not None and _agree(first, second, tolerance):
        return None
    return Difference("another line", *_shown(first), *_shown(second))


def _agree(a: Line, b: Line, tolerance: Tolerance) -> bool:
    if a.text == b.text:
        return True
    if _PRINT_TIME.match(a.text):
        return _NUMBER.sub(b"", a.text) == _NUMBER.sub(b"", b.text)
    first, second = command(a), command(b)
    if first is None or second is None or not first.name == second.name == "G92":
        return False
    here, there = numbers(a, first.arguments, "XYZE"), numbers(b, second.arguments, "XYZE")
    same = here.keys() == there.keys()
    return same and all(abs(here[name] - there[name]) <= tolerance.place for name in here)


def _shown(line: Line | None) -> tuple[int | None, str]:
    if line is None:
        return None, ""
    return line.number, one_line(line.text.decode("utf-8", "replace"))


# ---------------------------------------------------------------------- motion


def _motion(
    a: MoveSection, b: MoveSection, tolerance: Tolerance
) -> tuple[float, Difference | None]:
    """Return the largest distance and the earliest difference of the motion in two sections."""
    judged = [(s, _distances(s, other, tolerance)) for s, other in ((a, b), (b, a))]
    largest = max(float(distances.max()) for _, distances in judged)
    late = float(b.time[-1] - a.time[-1])
    if largest > tolerance.place:
        beyond = [s.time[distances > tolerance.place] for s, distances in judged]
        time = min(float(times[0]) for times in beyond if len(times))
        return largest, Difference(_how(a, b, time, tolerance), *_at(a, time), *_at(b, time))
    if abs(late) > tolerance.slack:
        how = f"the same path takes b {abs(late) * 1e3:.4g} ms {'longer' if late > 0 else 'less'}"
        return largest, Difference(how, *_at(a, a.time[-1]), *_at(b, b.time[-1]))
    return largest, None


def _drift(
    a: MoveSection, b: MoveSection, duration: list[float], tolerance: Tolerance
) -> Difference | None:
    """Return a difference in time that is small in each section and adds up to too much."""
    late = duration[1] - duration[0]
    if abs(late) <= tolerance.slack + MAX_DRIFT * max(duration):
        return None
    how = f"b is now {abs(late) * 1e3:.4g} ms {'later' if late > 0 else 'earlier'} in total"
    return Difference(how, *_at(a, a.time[-1]), *_at(b, b.time[-1]))


def _distances(section: MoveSection, path: MoveSection, tolerance: Tolerance) -> Array:
    """Return the distance (n + 1,) in mm of each vertex to a path at about the same time."""
    there = [np.interp(section.time, path.time, column) for column in path.xyze.T]
    distances = np.sqrt(np.square(section.xyze - np.column_stack(there)).sum(axis=1))
    far = np.flatnonzero(distances > tolerance.place)
    for some in np.split(far, range(VERTICES_AT_ONCE, len(far), VERTICES_AT_ONCE)):
        near = _nearest(section.xyze[some], section.time[some], path, tolerance.slack)
        distances[some] = np.minimum(distances[some], near)
    return np.asarray(distances)


def _nearest(places: Array, times: Array, path: MoveSection, slack: float) -> Array:
    """Return the distance (k,) of places (k, 4) to the path within ``slack`` of times (k,)."""
    segments, last = np.diff(path.xyze, axis=0), len(path.line) - 1
    if last < 0 or not len(places):
        return np.asarray(np.sqrt(np.square(places - path.xyze[0]).sum(axis=1)))
    low = np.clip(np.searchsorted(path.time, times - slack, "right") - 1, 0, last)
    high = np.clip(np.searchsorted(path.time, times + slack, "left") - 1, low, last)
    many = high - low + 1
    start = np.cumsum(many) - many
    owner = np.repeat(np.arange(len(places)), many)
    k = np.arange(len(owner)) - start[owner] + low[owner]
    before, takes = path.time[k], path.time[k + 1] - path.time[k]
    from_start = places[owner] - path.xyze[k]
    length2 = np.square(segments[k]).sum(axis=1)
    length2[length2 == 0.0] = 1.0  # a dwell: every share is equally near
    share = (from_start * segments[k]).sum(axis=1) / length2
    earliest = np.clip((times[owner] - slack - before) / takes, 0.0, 1.0)
    latest = np.clip((times[owner] + slack - before) / takes, 0.0, 1.0)
    share = np.clip(share, earliest, latest)
    distance = np.sqrt(np.square(from_start - share[:, None] * segments[k]).sum(axis=1))
    return np.asarray(np.minimum.reduceat(distance, start))


def _how(a: MoveSection, b: MoveSection, time: float, tolerance: Tolerance) -> str:
    """Return in words what is different at this time of the sections' motion."""
    here, there = _place(a, time), _place(b, time)
    at, ever = np.array([time]), float(a.time[-1] + b.time[-1])
    distances = (_nearest(here[None], at, b, ever)[0], _nearest(there[None], at, a, ever)[0])
    if max(distances) <= tolerance.place:
        return "b reaches the same position at another time"
    off = there - here
    shown = [k for k in range(len(AXES)) if abs(off[k]) > 0.1 * np.abs(off).max()]
    return "b is elsewhere: " + ", ".join(f"{AXES[k]} {off[k]:+.4g} mm" for k in shown)


def _place(section: MoveSection, time: float) -> Array:
    """Return x, y, z, e (4,) at a time of the section's motion."""
    return np.array([np.interp(time, section.time, column) for column in section.xyze.T])


def _at(section: MoveSection, time: float) -> tuple[int | None, str]:
    """Return the source line that is executed at a time, and the position as text."""
    k = int(np.searchsorted(section.time, time, "left")) - 1
    k = min(max(k, 0), len(section.line) - 1)
    closing = None if section.closing is None else section.closing.number
    line = int(section.line[k]) if len(section.line) else closing
    x, y, z, e = _place(section, time)
    return line, f"X{x:.4f} Y{y:.4f} Z{z:.4f} E{e:.5f}, {time:.4f} s into this motion"
