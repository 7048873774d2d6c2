"""Parts of a queue of moves, and of a plan, whose lifts and retractions are moves among others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.stream.marks import Marks
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
    at, n = 0, len(plan.line)
    for index, item in plan.standing:
        if index > at:
            yield part(plan, at, index)
        at = index + isinstance(item, MoveAtRest)
        yield item
    if not at:
        yield plan
    elif at < n:
        yield part(plan, at, n)


def part(plan: Plan, first: int, last: int) -> Plan:
    """Return moves ``first`` … ``last`` − 1 of a plan, which end where a run does, or rest.

    Lifts and retractions among them are left out.
    """
    a, b = plan.ends.searchsorted((first, last)).tolist()
    marks = plan.marks
    if marks:
        begin = marks.count_before(first + 1) if first else 0
        marks = marks.rows(begin, marks.count_before(last + 1)).shifted(-first)
    return Plan(
        plan.line[first:last], plan.points[first : last + 1],
        plan.s[first : last + 1] - plan.s[first], plan.ends[a : b + 1] - first,
        plan.speed[a : b + 1], plan.cruise[a:b], plan.acceleration[a:b], marks,
        rests=last < len(plan.line),
    )  # fmt: skip
