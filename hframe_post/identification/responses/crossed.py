"""What each recording shows of both axes while one is commanded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from hframe_post.arrays import X
from hframe_post.errors import IdentificationError
from hframe_post.identification.responses.frequency_response import FrequencyResponse
from hframe_post.identification.responses.full_response import DirectedRun, full_response
from hframe_post.identification.responses.measured import RunGroup, RunResponse

ROCKING = 1.0 / 3.0  # of the lowest resonance, below which a frame rocks


@dataclass(frozen=True, slots=True)
class Crossed:
    """Responses along and across the commanded axis, around ``place`` (x, y), mm."""

    along: FrequencyResponse
    across: FrequencyResponse
    place: tuple[float, float]


def crossed(axis: int, group: RunGroup, band_hz: tuple[float, float]) -> list[Crossed]:
    """Return what each recording shows of a command in an axis, X or Y, within what is excited.

    Far below the resonances the frame may rock on its table, and sideways, too: that is left out.
    """
    rocking = ROCKING * min(group.lowest_hz, band_hz[1])  # a stiff printer has no resonance
    low, high = group.excited_hz
    band = max(band_hz[0], low, rocking), min(band_hz[1], high)
    alone = [run for run in group.runs if run.direction and run.direction[1 - axis] == 0.0]
    found = [
        Crossed(run.response, run.across, run.point) for run in alone if run.across is not None
    ]
    return [
        replace(one, along=one.along.within(band), across=one.across.within(band))
        for one in found or _of_diagonals(axis, group.runs)
    ]


def _of_diagonals(axis: int, runs: Sequence[RunResponse]) -> list[Crossed]:
    """Return what a command in an axis does, from all runs along diagonals together.

    It is a difference of recordings whose starts are not known to each other, wrong alike if all
    are repeated. So it counts as one recording.
    """
    directed = [_directed(axis, run) for run in runs if run.across is not None]
    try:
        full = full_response(directed)
    except IdentificationError:  # all have one direction
        return []
    return [Crossed(full.entry(axis, axis), full.entry(1 - axis, axis), full.middle)]


def _directed(axis: int, run: RunResponse) -> DirectedRun:
    assert run.direction is not None
    moved = run.scaled(run.direction[axis])  # per motion along the diagonal
    assert moved.across is not None
    x, y = (moved.response, moved.across)[:: 1 if axis == X else -1]
    return DirectedRun(run.direction, run.point, x, y)
