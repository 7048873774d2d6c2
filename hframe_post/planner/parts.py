"""Parts of a queue of moves, and of a plan, whose lifts and retractions are moves among others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.stream.marks import NO_MARKS, Marks
from hframe_post.stream.types import MoveAtRest, Plan


@dataclass(frozen=True, slots=True)
class Limited:
    """Moves; limits (n, 5): see ``limit_moves``; caps (n,): greatest speeds at which they begin.

    corners (n,): those at which the firmware means to.
    """

    line: Integers
    points: Array
    limits: Array
    caps: Array
    corners: Array

    def part(self, start: int, stop: int) -> Limited:
        points = self.points[start : stop + 1]
        own = self.limits[start:stop], self.caps[start:stop], self.corners[start:stop]
        return Limited(self.line[start:stop], points, *own)


def joined(parts: list[Limited]) -> Limited:
    """Return moves that follow each other as one."""
    if len(parts) == 1:
        return parts[0]
    points = [parts[0].points, *(p.points[1:] for p in parts[1:])]
    return Limited(
        np.concatenate([p.line for p in parts]),
        np.concatenate(points),
        np.concatenate([p.limits for p in parts]),
        np.concatenate([p.caps for p in parts]),
        np.concatenate([p.corners for p in parts]),
    )


def parts(plan: Plan) -> Iterator[Plan | MoveAtRest | Marks]:
    """Yield the parts of a plan: motion, lifts and retractions, and the lines between them.

    x and y come to rest between them. A step by which motion brakes late is none of theirs.
    """
    n = len(plan.line)
    cuts, at = list[tuple[int, int]](), 0  # from one move to before another
    for index, item in plan.standing:
        cuts.append((at, index))
        at = index + isinstance(item, MoveAtRest)
    if not at:  # not cut by anything
        yield from (item for _, item in plan.standing)
        yield plan
        return
    cuts.append((at, n))
    bounds = np.array(cuts)
    rows = plan.marks.at.searchsorted(bounds + (bounds > 0)).tolist()
    items = (item for _, item in plan.standing)
    for (first, last), own in zip(cuts, rows, strict=True):
        if first < last:
            yield part(plan, first, last, plan.marks.rows(*own))
        if (between := next(items, None)) is not None:
            yield between


def part(plan: Plan, first: int, last: int, marks: Marks = NO_MARKS) -> Plan:
    """Return moves ``first`` … ``last`` − 1 of a plan, which end where a run does, or rest.

    Lifts and retractions among them are left out. marks: theirs, with the plan's indices.
    """
    a, b = plan.ends.searchsorted((first, last)).tolist()
    return Plan(
        plan.line[first:last], plan.points[first : last + 1],
        plan.s[first : last + 1] - plan.s[first], plan.ends[a : b + 1] - first,
        plan.speed[a : b + 1], plan.cruise[a:b], plan.acceleration[a:b], marks.shifted(-first),
        rests=last < len(plan.line),
    )  # fmt: skip
