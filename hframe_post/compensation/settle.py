"""Rests: the standstill around what happens at rest, as long as the command needs it.

After a stop the compensated command goes on for a while, and before motion it leads.
``rests`` says how long that can take at worst, and the planner offers so much around every
standstill. ``settle`` cuts each to where the command is within the tolerance of the path, and
fades it to the path over the last samples, so that the command stands exactly on it when the
machine does something else.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import TS, Array, X, Z
from hframe_post.compensation.compensate import compensate
from hframe_post.model.course import Compensator
from hframe_post.printer.settings import Limits, Travel
from hframe_post.stream.chunks import join, part
from hframe_post.stream.types import Event, Mark, Pause, Rest, Rests, Samples, frozen

T = TypeVar("T", bound=np.generic)

OUTLASTS = 4096  # samples of standstill in which any stable command settles
FADE = 10  # samples over which what is left of the command's deviation goes to zero
LEAD_SHARE = 0.2  # of the tolerance before motion, whose first millimetres it would spoil
NOTHING = 1e-4  # mm; a deviation that need not be faded


def rests(compensator: Compensator, limits: Limits, travel: Travel, tolerance: float) -> Rests:
    """Standstill that the fastest stop and start on this bed can need.

    Both in x and y at once, at the longest lever arm: the samples for which the command is off
    the path by more than LEAD_SHARE of ``tolerance``, mm.
    """
    plant = compensator.plant
    lever = max(abs(edge - plant.x_c) for edge in travel.x)
    ramp = np.arange(0.0, limits.velocity + 1e-9, limits.acceleration * TS)
    cruise = np.full(OUTLASTS // 8, limits.velocity)
    moving = np.cumsum(np.concatenate([ramp, cruise, ramp[::-1]])) * TS
    path = np.pad(moving, OUTLASTS, mode="edge")
    path[:OUTLASTS] = 0.0
    xyze = np.column_stack([path, path, np.zeros((len(path), 2))])
    xyze[:, X] += plant.x_c + lever
    line = np.zeros(len(path), dtype=np.int64)
    commanded = compensate([Samples(0, xyze, line)], compensator, ("racking",))
    off = np.concatenate([c.commands["racking"] - c.xyze[:, :Z] for c in commanded])
    beyond = np.flatnonzero(np.abs(off).max(axis=1) > LEAD_SHARE * tolerance)
    if not len(beyond):
        return Rests(settle=1, lead=1)
    stopped = OUTLASTS + len(moving)
    return Rests(max(int(beyond[-1]) - stopped, 1), max(OUTLASTS - int(beyond[0]), 1))


def settle(chunks: Iterable[Samples], strategy: str, tolerance: float) -> Iterator[Samples]:
    """The stream with shorter rests; the command ``strategy`` decides for all commands.

    tolerance: mm that the command may be off the path when it is cut and faded.
    """
    held: list[Samples] = []
    first = 0
    for chunk in chunks:
        held.append(chunk)
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
            settled = _settled(whole, first, strategy, tolerance)
            first = settled.end
            yield settled
    if held:  # a rest is always followed by all of its samples
        yield _settled(join(held), first, strategy, tolerance)


def _settled(chunk: Samples, first: int, strategy: str, tolerance: float) -> Samples:
    """One chunk whose rests are complete, cut and renumbered to begin at ``first``."""
    pieces: list[tuple[slice, Array | None]] = []  # what stays, and how much of the deviation
    events: list[Event] = []
    done = removed = 0
    for event in chunk.events:
        at = event.index - chunk.first
        index = first + at - removed
        if isinstance(event, Mark):
            events.append(Mark(index, event.text))
            continue
        pieces.append((slice(done, at), None))
        done = at + event.samples
        if isinstance(event, Rest):
            rest = slice(at, done)
            off = np.abs(chunk.commands[strategy][rest] - chunk.xyze[rest, :Z])
            fade = _fade(np.maximum(off[:, 0], off[:, 1]), event.settling, tolerance)
            left = slice(at, at + len(fade)) if event.settling else slice(done - len(fade), done)
            pieces.append((left, fade))
            removed += event.samples - len(fade)
            events.append(Rest(index, len(fade), event.settling))
        else:
            pieces.append((slice(at, done), np.zeros(event.samples)))
            events.append(Pause(index, event.samples, event.action, event.exact))
    pieces.append((slice(done, len(chunk)), None))
    return Samples(
        first,
        _kept(chunk.xyze, pieces),
        _kept(chunk.line, pieces),
        tuple(events),
        {name: _faded(xy, chunk.xyze[:, :Z], pieces) for name, xy in chunk.commands.items()},
        chunk.ends_stretch,
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
