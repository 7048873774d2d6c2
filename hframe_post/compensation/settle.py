"""Cuts the standstill around what happens at rest to what the command needs.

After a stop the compensated command goes on for a while, and before motion it leads. The
rests offered for this are as long as the worst case; here each is cut to where the command
is within the tolerance of the path, and faded to the path over the last samples, so that
the command stands exactly on it when the machine does something else.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import Array, Z
from hframe_post.stream.chunks import join, part
from hframe_post.stream.types import Event, Mark, Pause, Rest, Samples, frozen

T = TypeVar("T", bound=np.generic)

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
                if not isinstance(event, Mark) and event.index + event.samples > whole.end
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
    if held:  # a rest is always followed by all of its samples
        yield _settled(join(held), first, written, tolerance)


def _settled(block: Samples, first: int, written: str, tolerance: float) -> Samples:
    """One block whose rests are complete, cut and renumbered to begin at ``first``."""
    pieces: list[tuple[slice, Array | None]] = []  # what stays, and how much of the deviation
    events: list[Event] = []
    done = removed = 0
    for event in block.events:
        at = event.index - block.first
        index = first + at - removed
        if isinstance(event, Mark):
            events.append(Mark(index, event.text))
            continue
        pieces.append((slice(done, at), None))
        done = at + event.samples
        if isinstance(event, Rest):
            rest = slice(at, done)
            off = np.abs(block.commands[written][rest] - block.xyze[rest, :Z])
            fade = _fade(np.maximum(off[:, 0], off[:, 1]), event.settling, tolerance)
            left = slice(at, at + len(fade)) if event.settling else slice(done - len(fade), done)
            pieces.append((left, fade))
            removed += event.samples - len(fade)
            events.append(Rest(index, len(fade), event.settling))
        else:
            pieces.append((slice(at, done), np.zeros(event.samples)))
            events.append(Pause(index, event.samples, event.action, event.exact))
    pieces.append((slice(done, len(block)), None))
    return Samples(
        first,
        _kept(block.xyze, pieces),
        _kept(block.line, pieces),
        tuple(events),
        {name: _faded(xy, block.xyze[:, :Z], pieces) for name, xy in block.commands.items()},
    )


def _fade(deviation: Array, settling: bool, tolerance: float) -> Array:
    """Share of the deviation that the samples of a rest keep, (k,) for the k that are needed.

    The needed ones are the first of the n of a settling rest, and the last of a leading one.
    """
    away = deviation if settling else deviation[::-1]  # seen from the motion
    if not len(away) or away[0] <= NOTHING:
        return np.zeros(0)
    beyond = np.flatnonzero(away > (tolerance if settling else LEAD_SHARE * tolerance))
    needed = int(beyond[-1]) + 1 if len(beyond) else 0
    length = min(needed + FADE, len(away))
    ramp = np.arange(1, min(FADE, length) + 1) / min(FADE, length)
    fade = np.ones(length)
    fade[length - len(ramp) :] = 0.5 + 0.5 * np.cos(np.pi * ramp)
    return fade if settling else fade[::-1]


def _kept(column: NDArray[T], pieces: list[tuple[slice, Array | None]]) -> NDArray[T]:
    """The rows that stay."""
    kept = np.concatenate([column[rows] for rows, _ in pieces])
    kept.flags.writeable = False
    return kept


def _faded(command: Array, path: Array, pieces: list[tuple[slice, Array | None]]) -> Array:
    """A command (n, 2) with its rows cut, and its deviation from the path faded."""
    return frozen(
        np.concatenate(
            [
                command[rows]
                if fade is None
                else path[rows] + fade[:, None] * (command[rows] - path[rows])
                for rows, fade in pieces
            ]
        )
    )
