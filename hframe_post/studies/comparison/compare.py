"""Do two files ask a printer for the same? The same lines, and the same motion in place and time.

Between two lines that are no moves, each file is a path in nominal time. They are the same if
every vertex of either finds the other path within the tolerance, no more than ``slack`` earlier
or later. So the same motion cut into other segments is still the same motion.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import GcodeError, one_line
from hframe_post.gcode.commands import Dialect
from hframe_post.gcode.lexer import Line, command, numbers
from hframe_post.gcode.state import AXES
from hframe_post.studies.comparison.motion_file import Section, sections

DRIFT = 1e-4  # of the time of all motion, by which rounded feed rates may add up
AT_ONCE = 1 << 16  # vertices

_PRINT_TIME = re.compile(
    rb";\s*TIME(_ELAPSED)?:|[Mm]73\s|; estimated (printing|first layer printing) time"
)
SUMMARY = b"; hframe-post:"  # what a conversion tells of itself
_NUMBER = re.compile(rb"[\d.]+")


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far apart two paths may be: mm in place and in filament, s in time."""

    place: float = 1e-3
    slack: float = 1e-3


@dataclass(frozen=True, slots=True)
class Difference:
    """The first one. a, b: source lines, None past the end; texts: what is there."""

    what: str
    a: int | None
    a_text: str
    b: int | None
    b_text: str


@dataclass(frozen=True, slots=True)
class Comparison:
    """What was compared until the first difference, if there is one.

    moves: of either file. others: lines that are no moves. apart: largest distance in place of
    vertices from the other path, mm; duration: nominal time of the motion in either file, s.
    """

    moves: tuple[int, int]
    others: int
    apart: float
    duration: tuple[float, float]
    difference: Difference | None

    @property
    def same(self) -> bool:
        """Whether there is no difference."""
        return self.difference is None

    def as_json(self) -> dict[str, Any]:
        """Everything, ready for ``json.dumps``."""
        return {
            "same": self.same,
            "moves": list(self.moves),
            "other_lines": self.others,
            "apart_um": round(self.apart * 1e3, 4),
            "motion_s": [round(seconds, 6) for seconds in self.duration],
            "first_difference": asdict(self.difference) if self.difference else None,
        }

    def as_text(self) -> str:
        """A few lines for a person."""
        counts = (
            f"{self.moves[0]} and {self.moves[1]} moves, {self.others} other lines, "
            f"{self.duration[0]:.3f} and {self.duration[1]:.3f} s of motion"
        )
        if self.difference is None:
            return f"same: at most {self.apart * 1e3:.3g} µm apart; {counts}"
        told = self.difference
        return "\n".join(
            (
                f"different: {told.what}",
                f"  a, {_where(told.a)}: {told.a_text}",
                f"  b, {_where(told.b)}: {told.b_text}",
                f"the same up to there: {counts}",
            )
        )


def _where(line: int | None) -> str:
    return "end of file" if line is None else f"line {line}"


def compare(
    a: Iterable[bytes], b: Iterable[bytes], dialect: Dialect, tolerance: Tolerance | None = None
) -> Comparison:
    """Compares two files up to the first difference, streaming. Raises GcodeError.

    Lines that tell of print time may give other numbers, and G92 numbers within the tolerance.
    """
    tolerance = tolerance or Tolerance()
    moves, duration, apart, others = [0, 0], [0.0, 0.0], 0.0, 0
    pairs = zip(_of(a, dialect, "a"), _of(b, dialect, "b"), strict=False)
    for first, second in pairs:  # a file's last section has no closing line: both end together
        difference = _closing(first, second, tolerance)
        if difference is None:
            distance, difference = _motion(first, second, tolerance)
            apart = max(apart, distance)
            for k, section in enumerate((first, second)):
                moves[k] += len(section.line)
                duration[k] += float(section.time[-1])
        difference = difference or _drift(first, second, duration, tolerance)
        if difference is not None:
            break
        others += first.closing is not None
    else:
        difference = None
    return Comparison((moves[0], moves[1]), others, apart, (duration[0], duration[1]), difference)


def _of(lines: Iterable[bytes], dialect: Dialect, name: str) -> Iterator[Section]:
    try:
        yield from sections(lines, dialect)
    except GcodeError as error:
        where = "" if error.line is None else f"line {error.line}: "
        raise GcodeError(f"{name}: {where}{error.cause}", None, error.text) from None


# ---------------------------------------------------------------------- other lines


def _closing(a: Section, b: Section, tolerance: Tolerance) -> Difference | None:
    """The lines after the motion, which say the same or make all that follows incomparable."""
    first, second = a.closing, b.closing
    if first is second is None:
        return None
    if first is not None and second is not None and _agree(first, second, tolerance):
        return None
    return Difference("another line", *_shown(first), *_shown(second))


def _agree(a: Line, b: Line, tolerance: Tolerance) -> bool:
    if a.text == b.text or all(line.text.startswith(SUMMARY) for line in (a, b)):
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


def _motion(a: Section, b: Section, tolerance: Tolerance) -> tuple[float, Difference | None]:
    """The largest distance, and the earliest difference, of the motion in two sections."""
    judged = [(s, _distances(s, other, tolerance)) for s, other in ((a, b), (b, a))]
    apart = max(float(distances.max()) for _, distances in judged)
    late = float(b.time[-1] - a.time[-1])
    if apart > tolerance.place:
        beyond = [s.time[distances > tolerance.place] for s, distances in judged]
        time = min(float(times[0]) for times in beyond if len(times))
        return apart, Difference(_how(a, b, time, tolerance), *_at(a, time), *_at(b, time))
    if abs(late) > tolerance.slack:
        how = f"the same path takes b {abs(late) * 1e3:.4g} ms {'longer' if late > 0 else 'less'}"
        return apart, Difference(how, *_at(a, a.time[-1]), *_at(b, b.time[-1]))
    return apart, None


def _drift(
    a: Section, b: Section, duration: list[float], tolerance: Tolerance
) -> Difference | None:
    """Times that differ by little in each section, and by too much in all."""
    late = duration[1] - duration[0]
    if abs(late) <= tolerance.slack + DRIFT * max(duration):
        return None
    how = f"b has come to be {abs(late) * 1e3:.4g} ms {'later' if late > 0 else 'earlier'}"
    return Difference(how, *_at(a, a.time[-1]), *_at(b, b.time[-1]))


def _distances(of: Section, path: Section, tolerance: Tolerance) -> Array:
    """How far each vertex is from the other path at about the same time, (n + 1,), mm."""
    there = [np.interp(of.time, path.time, column) for column in path.xyze.T]
    distances = np.sqrt(np.square(of.xyze - np.column_stack(there)).sum(axis=1))
    far = np.flatnonzero(distances > tolerance.place)
    for some in np.split(far, range(AT_ONCE, len(far), AT_ONCE)):
        near = _nearest(of.xyze[some], of.time[some], path, tolerance.slack)
        distances[some] = np.minimum(distances[some], near)
    return np.asarray(distances)


def _nearest(places: Array, times: Array, path: Section, slack: float) -> Array:
    """Distance of places (k, 4) to where the path is within ``slack`` of the times (k,), (k,)."""
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
    length2[length2 == 0.0] = 1.0  # dwells: any share is as near
    share = (from_start * segments[k]).sum(axis=1) / length2
    earliest = np.clip((times[owner] - slack - before) / takes, 0.0, 1.0)
    latest = np.clip((times[owner] + slack - before) / takes, 0.0, 1.0)
    share = np.clip(share, earliest, latest)
    distance = np.sqrt(np.square(from_start - share[:, None] * segments[k]).sum(axis=1))
    return np.asarray(np.minimum.reduceat(distance, start))


def _how(a: Section, b: Section, time: float, tolerance: Tolerance) -> str:
    """What is different at this time of the sections' motion, in words."""
    here, there = _place(a, time), _place(b, time)
    at, ever = np.array([time]), float(a.time[-1] + b.time[-1])
    astray = (_nearest(here[None], at, b, ever)[0], _nearest(there[None], at, a, ever)[0])
    if max(astray) <= tolerance.place:
        return "b is at the same place at another time"
    off = there - here
    told = [k for k in range(len(AXES)) if abs(off[k]) > 0.1 * np.abs(off).max()]
    return "b is elsewhere: " + ", ".join(f"{AXES[k]} {off[k]:+.4g} mm" for k in told)


def _place(section: Section, time: float) -> Array:
    """x, y, z, e at a time of the section's motion, (4,)."""
    return np.array([np.interp(time, section.time, column) for column in section.xyze.T])


def _at(section: Section, time: float) -> tuple[int | None, str]:
    """The source line of what is under way then, and where that is."""
    k = int(np.searchsorted(section.time, time, "left")) - 1
    k = min(max(k, 0), len(section.line) - 1)
    closing = None if section.closing is None else section.closing.number
    line = int(section.line[k]) if len(section.line) else closing
    x, y, z, e = _place(section, time)
    return line, f"X{x:.4f} Y{y:.4f} Z{z:.4f} E{e:.5f}, {time:.4f} s into this motion"
