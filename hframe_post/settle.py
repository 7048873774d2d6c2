"""Cuts the standstill around what happens at rest to what the command needs.

After a stop the compensated command goes on for a while, and before motion it leads. The
rests offered for this are as long as the worst case; here each is cut to where the command
is within the tolerance of the path, and faded to the path over the last samples, so that
the command stands exactly on it when the machine does something else.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from hframe_post.arrays import Array, Flags
from hframe_post.recut import join, part
from hframe_post.stream import Event, Mark, Pause, Rest, Samples, Z, frozen

FADE = 10  # samples over which what is left of the command's deviation goes to zero
LEAD_SHARE = 0.2  # of the tolerance before motion, whose first millimetres it would spoil
NOTHING = 1e-4  # mm; a deviation that need not be faded


def settle(blocks: Iterable[Samples], written: str, tolerance: float) -> Iterator[Samples]:
    """The stream with shorter rests; the command ``written`` decides for all commands.

    tolerance: mm that the command may be off the path when it is cut and faded.
    """
    held: list[Samples] = []
    first = 0
    for block in blocks:
        held.append(block)
        whole = join(held)
        cut = min(
            (
                event.index - whole.first
                for event in whole.events
                if isinstance(event, Rest) and event.index + event.samples > whole.end
            ),
            default=len(whole),
        )
        if cut < len(whole):
            held = [part(whole, cut, len(whole))]
            whole = part(whole, 0, cut)
        else:
            held = []
        if len(whole) or whole.events:
            settled = _settled(whole, first, written, tolerance)
            first = settled.end
            yield settled
    if held:  # a rest is always followed by its own samples
        yield _settled(join(held), first, written, tolerance)


def _settled(block: Samples, first: int, written: str, tolerance: float) -> Samples:
    """One block whose rests are complete, cut and renumbered to begin at ``first``."""
    path = block.xyze[:, :Z]
    deviation = np.abs(block.commands[written] - path).max(axis=1, initial=0.0)
    keep = np.ones(len(block), dtype=bool)
    fade = np.ones(len(block))
    for event in block.events:
        if isinstance(event, Rest):
            where = slice(event.index - block.first, event.index - block.first + event.samples)
            keep[where], fade[where] = _cut(deviation[where], event.settling, tolerance)
        elif isinstance(event, Pause):
            start = event.index - block.first
            fade[start : start + event.samples] = 0.0
    commands = {}
    for name, xy in block.commands.items():
        faded = path + fade[:, None] * (xy - path) if name != "none" else path
        commands[name] = frozen(faded[keep])
    return Samples(
        first,
        frozen(block.xyze[keep]),
        block.line[keep],
        _renumbered(block, keep, first),
        commands,
    )


def _cut(deviation: Array, settling: bool, tolerance: float) -> tuple[Flags, Array]:
    """Samples of a rest to keep, and what share of the deviation; both (n,)."""
    n = len(deviation)
    away = deviation if settling else deviation[::-1]  # seen from the motion
    tolerance *= 1.0 if settling else LEAD_SHARE
    keep, fade = np.zeros(n, dtype=bool), np.zeros(n)
    if n and away[0] > NOTHING:
        beyond = np.flatnonzero(away > tolerance)
        needed = int(beyond[-1]) + 1 if len(beyond) else 0
        length = min(needed + FADE, n)
        ramp = np.arange(1, length - max(length - FADE, 0) + 1)
        keep[:length], fade[:length] = True, 1.0
        fade[length - len(ramp) : length] = 0.5 + 0.5 * np.cos(np.pi * ramp / len(ramp))
    return (keep, fade) if settling else (keep[::-1], fade[::-1])


def _renumbered(block: Samples, keep: Flags, first: int) -> tuple[Event, ...]:
    """The events at the samples that are left; rests say how much of them is left."""
    before = first + np.concatenate([[0], np.cumsum(keep)])
    events: list[Event] = []
    for event in block.events:
        at = event.index - block.first
        index = int(before[at])
        if isinstance(event, Rest):
            left = int(before[at + event.samples]) - index
            events.append(Rest(index, left, event.settling))
        elif isinstance(event, Pause):
            events.append(Pause(index, event.samples, event.action, event.exact))
        else:
            events.append(Mark(index, event.text))
    return tuple(events)
