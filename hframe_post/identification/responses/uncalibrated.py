"""Frequency responses from recordings that tell neither start, nor axes, nor gain.

    runs → own clock and direction → responses along and across → one delay and gain for each axis

The swept axis is where the answer points at low frequencies. Across it lies the other axis as a
run of that axis shows it, if the sensor was mounted alike in both; else the horizontal direction
at right angles, by gravity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.alignment import acceleration
from hframe_post.identification.recordings.self_alignment import SelfAligned, self_aligned
from hframe_post.identification.responses.direction import Direction, direction
from hframe_post.identification.responses.frequency_response import (
    FrequencyResponse,
    advanced,
    estimate,
)
from hframe_post.identification.responses.measured import (
    Run,
    RunGroup,
    RunResponse,
    Settings,
    with_common_delay,
)

ALIKE = np.cos(np.radians(8.0))  # of two directions of gravity, or of one axis, of one mounting
UPRIGHT = np.sin(np.radians(25.0))  # of the angle by which two axes may differ from 90°


@dataclass(frozen=True, slots=True)
class _Located:
    run: Run
    aligned: SelfAligned
    direction: Direction


def uncalibrated_responses(runs: Sequence[Run], settings: Settings) -> dict[int, RunGroup]:
    """Return the responses of the runs of each axis, X or Y, that were recorded.

    Raises IdentificationError, which names the run.
    """
    located = [_located(run, settings) for run in runs]
    return {axis: _group(axis, located, settings)
            for axis in (X, Y) if any(one.run.axis == axis for one in located)}  # fmt: skip


def _located(run: Run, settings: Settings) -> _Located:
    assert run.nozzle is not None
    try:
        command = acceleration(run.command[:, run.axis])
        found = self_aligned(command, run.nozzle, run.rough_clock)
        answers = [_response(found, axis, settings) for axis in np.eye(3)]
        return _Located(run, found, direction(answers))
    except IdentificationError as error:
        raise IdentificationError(f"{run.name}: {error}") from None


def _response(found: SelfAligned, axis: Array, settings: Settings) -> FrequencyResponse:
    return estimate(found.command, found.acceleration @ axis).within(settings.band_hz)


def _group(axis: int, located: Sequence[_Located], settings: Settings) -> RunGroup:
    chosen = [one for one in located if one.run.axis == axis]
    others = [one for one in located if one.run.axis != axis]
    responses = []
    for one in chosen:
        along = _response(one.aligned, one.direction.axis, settings)
        across = along if axis == Y else _response(one.aligned, _across(one, others), settings)
        place, swept = one.run.place + settings.offset[X], one.run.command[:, axis]
        along, across = (advanced(H, one.direction.delay) for H in (along, across))
        responses.append(RunResponse(place, along, across, 0.0, swept))
    low = max(one.direction.excited_hz for one in chosen)
    resonance = float(np.median([one.direction.resonance_hz for one in chosen]))
    group = with_common_delay(_with_common_gain(responses, low, resonance))
    return replace(group, delay_bounds=(0.0, 0.0), excited_hz=low, resonance_hz=resonance)


def _across(one: _Located, others: Sequence[_Located]) -> Array:
    """Return the direction (3,) of +y in the recording of a run in x."""
    along, up = one.direction.axis, one.aligned.up
    for other in others:
        y = other.direction.axis
        mounted_alike = other.aligned.up @ up > ALIKE or not up.any()
        if mounted_alike and abs(y @ along) < UPRIGHT:
            across = y - (y @ along) * along
            return np.asarray(across / np.linalg.norm(across))
    if not up.any():
        raise IdentificationError(
            f"{one.run.name}: the recording does not show gravity, and no run of y shows where y "
            "points. Record y with the sensor mounted alike"
        )
    across = np.cross(up, along)
    return np.asarray(across / np.linalg.norm(across))


def _with_common_gain(
    responses: Sequence[RunResponse], low: float, resonance_hz: float
) -> list[RunResponse]:
    """Return the responses with the gain of the first, as the answers below resonance show it.

    Sensors, and the strength of the excitation, may differ from session to session.
    """
    hz = responses[0].response.hz
    below = (hz >= low) & (hz <= max(0.6 * resonance_hz, 1.5 * low))
    sizes = [float(np.abs(one.response.H[below]).mean()) for one in responses]
    return [
        replace(one, response=_scaled(one.response, sizes[0] / size),
                y=_scaled(one.y, sizes[0] / size))
        for one, size in zip(responses, sizes, strict=True)
    ]  # fmt: skip


def _scaled(response: FrequencyResponse, gain: float) -> FrequencyResponse:
    return replace(response, H=response.H * gain)
