"""Frequency responses from recordings that tell neither start, nor axes, nor gain.

    runs → own clock and direction → responses along and across → one delay and gain for each axis

The response points along the motion at low frequencies. Runs in two directions with the sensor
mounted alike show where x and y point; of one direction the other lies at right angles, by gravity.
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
    estimate,
)
from hframe_post.identification.responses.measured import (
    MeasurementSettings,
    Run,
    RunGroup,
    RunResponse,
    with_common_delay,
)

ALIKE = np.cos(np.radians(8.0))  # of gravity in two recordings of one mounting
SQUARE = np.sin(np.radians(25.0))  # by which directions in the sensor may differ from the command's
ALONG = 0.3  # of a motion's direction, from which it tells of an axis


@dataclass(frozen=True, slots=True)
class _Located:
    """A run and its direction: in x and y as commanded (2,), and as the sensor sees it."""

    run: Run
    aligned: SelfAligned
    commanded: Array
    seen: Direction


def uncalibrated_responses(
    runs: Sequence[Run], settings: MeasurementSettings
) -> dict[int, RunGroup]:
    """Return the responses of the runs of each axis, X or Y, that were recorded.

    A run along a diagonal counts for both axes if no run moves one of them alone. Raises
    IdentificationError, which names the run.
    """
    located = [_located(run, settings) for run in runs]
    groups = {}
    for axis in (X, Y):
        alone = [one for one in located if abs(one.commanded[axis]) > 1.0 - 1e-6]
        chosen = alone or [one for one in located if abs(one.commanded[axis]) > ALONG]
        if chosen:
            groups[axis] = _group(axis, chosen, located, settings)
    return groups


def _located(run: Run, settings: MeasurementSettings) -> _Located:
    try:
        found = self_aligned(acceleration(run.displacement), run.nozzle, run.rough_clock)
        responses = [_response(found, axis, settings) for axis in np.eye(3)]
        return _Located(run, found, run.direction, direction(responses))
    except IdentificationError as error:
        raise IdentificationError(f"{run.name}: {error}") from None


def _response(found: SelfAligned, axis: Array, settings: MeasurementSettings) -> FrequencyResponse:
    return estimate(found.command, found.acceleration @ axis).within(settings.band_hz)


def _group(
    axis: int,
    chosen: Sequence[_Located],
    located: Sequence[_Located],
    settings: MeasurementSettings,
) -> RunGroup:
    responses = [_run_response(axis, one, located, settings) for one in chosen]
    low = max(one.seen.excited_hz[0] for one in chosen)
    high = min(one.seen.excited_hz[1] for one in chosen)
    resonance = float(np.median([one.seen.resonance_hz for one in chosen]))
    group = with_common_delay(_with_common_gain(responses, low, resonance))
    # a mode that x and y share may be a clear peak in one of them only
    felt = (other for other in located if _mounted_alike(chosen[0], other))
    lowest = min(resonance, *(other.seen.resonance_hz for other in felt))
    return replace(
        group,
        delay_bounds=(0.0, 0.0),
        excited_hz=(low, high),
        resonance_hz=resonance,
        lowest_hz=lowest,
    )


def _run_response(
    axis: int, one: _Located, located: Sequence[_Located], settings: MeasurementSettings
) -> RunResponse:
    x, y = (_response(one.aligned, seen, settings) for seen in _axes(one, located))
    share = float(one.commanded[axis])
    alone = share > 1.0 - 1e-6  # a diagonal does not show racking alone
    along, across = (x, y) if axis == X else (y, x)
    px, py = (one.run.command.mean(axis=0) + settings.offset).tolist()
    found = RunResponse(
        px, along, y if alone else along, 0.0, across,
        (float(one.commanded[X]), float(one.commanded[Y])), (px, py),
    )  # fmt: skip
    return found.scaled(1.0 / share).advanced(one.seen.delay)


def _axes(one: _Located, located: Sequence[_Located]) -> Array:
    """Return what shows the printer's x and y, (2, 3), in the recording of a run.

    From all runs with the sensor mounted alike; of a single direction, from gravity.
    """
    mates = [other for other in located if _mounted_alike(one, other)]
    commanded = np.array([mate.commanded for mate in mates])
    seen = np.array([mate.seen.axis for mate in mates])
    if np.linalg.matrix_rank(commanded, tol=0.3) < 2:
        if not one.aligned.up.any():
            raise IdentificationError(
                f"{one.run.name}: the recording does not show gravity, and no other run shows "
                "where the other axis points. Record both axes with the sensor mounted alike"
            )
        turned = np.array([[-one.commanded[Y], one.commanded[X]]])
        commanded = np.concatenate([commanded, turned])
        seen = np.concatenate([seen, np.cross(one.aligned.up, one.seen.axis)[None]])
    axes = np.linalg.lstsq(commanded, seen, rcond=None)[
        0
    ]  # x and y as the sensor sees them, (2, 3)
    return np.asarray(np.linalg.pinv(axes.T))


def _mounted_alike(one: _Located, other: _Located) -> bool:
    known = one.aligned.up.any() and other.aligned.up.any()
    if known and float(one.aligned.up @ other.aligned.up) < ALIKE:
        return False
    angle = float(one.seen.axis @ other.seen.axis - one.commanded @ other.commanded)
    return bool(abs(angle) < SQUARE)


def _with_common_gain(
    responses: Sequence[RunResponse], low: float, resonance_hz: float
) -> list[RunResponse]:
    """Return the responses with the gain of the first, as the responses below resonance show it.

    Sensors, and the strength of the excitation, may differ from session to session.
    """
    hz = responses[0].response.hz
    below = (hz >= low) & (hz <= max(0.6 * resonance_hz, 1.5 * low))
    sizes = [float(np.abs(one.response.H[below]).mean()) for one in responses]
    return [one.scaled(sizes[0] / size) for one, size in zip(responses, sizes, strict=True)]
