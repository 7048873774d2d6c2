"""Moves → moves whose travel has the profile's own speed and acceleration.

Nobody sees how exactly travel is traced, so it may be driven harder than what is printed. A
profile that says nothing leaves it as the file has it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hframe_post.arrays import E, Z
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import Item, Moves, frozen


def with_own_travel(items: Iterable[Item], limits: Limits) -> Iterator[Item]:
    """The items with faster or slower travel.

    Travel extrudes nothing. Its acceleration is ``limits.travel_acceleration``, or what the file
    asks for in travel alone. Its speed is ``limits.travel_velocity`` where it is level, and no
    slower in the file than what was printed last: what is slower is meant to be, as where a
    nozzle is wiped.
    """
    if not (limits.travel_velocity or limits.travel_acceleration):
        yield from items
        return
    printed = np.inf  # mm/s, last; nothing yet
    for item in items:
        if not isinstance(item, Moves):
            yield item
            continue
        delta = np.diff(item.points, axis=0)
        travels = delta[:, E] == 0.0
        acceleration, speed = item.acceleration.copy(), item.speed.copy()
        if limits.travel_acceleration:
            acceleration[travels] = min(limits.travel_acceleration, item.limits.travel)
        printing = np.where(delta[:, E] > 0.0, np.arange(len(speed)), -1)
        last = np.maximum.accumulate(printing)
        before = np.where(last < 0, printed, item.speed[last])
        printed = float(item.speed[last[-1]]) if last[-1] >= 0 else printed
        if limits.travel_velocity:
            speed[travels & (delta[:, Z] == 0.0) & (item.speed >= before)] = limits.travel_velocity
        yield replace(item, speed=frozen(speed), acceleration=frozen(acceleration))
