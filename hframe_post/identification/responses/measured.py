"""Frequency responses of single runs, aligned to one common delay.

    runs → accelerations on the command's clock → frequency responses → one delay for all

A run moves one axis. A sensor on the nozzle gives Gxx from runs in x and Gyy from runs in y.
Racking comes from two sensors at the ends of the bridge (eq. 3),

    θ'' = (ÿ1 − ÿ2) / L_G,    Gxθ = θ'' / ẍ_d,

or from the nozzle's sensor alone, by runs in x at several places (``lever_arm``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings import place_mark
from hframe_post.identification.recordings.accelerometer import Recording
from hframe_post.identification.recordings.alignment import acceleration, aligned, heading, turned
from hframe_post.identification.responses.frequency_response import (
    FrequencyResponse,
    advanced,
    delays,
    estimate,
)
from hframe_post.identification.responses.harmonics import Harmonics, harmonics


@dataclass(frozen=True, slots=True)
class Run:
    """One sweep. command (m, 2): x and y in mm, every 1 ms; recordings in the printer's axes.

    bridge: the recordings at P1 (the greater x) and at P2.
    """

    name: str
    command: Array
    nozzle: Recording | None = None
    bridge: tuple[Recording, Recording] | None = None

    @property
    def axis(self) -> int:
        """Return X or Y, the axis that moves. Raise IdentificationError unless exactly one does."""
        moving = np.flatnonzero(np.ptp(self.command, axis=0) > 0.0)
        if len(moving) != 1:
            cause = "both axes move" if len(moving) else "no axis moves"
            raise IdentificationError(f"{self.name}: {cause}; a run must sweep x or y alone")
        return int(moving[0])

    @property
    def place(self) -> float:
        """Return the mean x of the run in mm."""
        return float(self.command[:, X].mean())


@dataclass(frozen=True, slots=True)
class Settings:
    """What `identify` needs to know about the measurement.

    L_G: distance of P1 and P2, mm. racks: whether the kinematics can rack. offset: from the
    nozzle to its sensor in x and y, mm. step: mm of belt for one motor step. sensor: gains of
    the sensor along x and y if they were measured with gravity.
    """

    band_hz: tuple[float, float]
    L_G: float | None = None
    racks: bool = True
    offset: tuple[float, float] = (0.0, 0.0)
    step: float = 0.02
    sensor: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class RunResponse:
    """Frequency responses of one run.

    response: along the swept axis, or racking. y: across, from the nozzle's sensor. place: x of
    the sensor, mm. late: half-width of the uncertainty of the recording's start, s. command (m,):
    mm along the swept axis. harmonics: None if the command has no marks.
    """

    place: float
    response: FrequencyResponse
    y: FrequencyResponse
    late: float
    command: Array
    harmonics: Harmonics | None = None


@dataclass(frozen=True, slots=True)
class RunGroup:
    """Runs shifted to one common delay, and the bounds of that delay in s."""

    runs: list[RunResponse]
    delay_bounds: tuple[float, float]


def nozzle_responses(runs: list[Run], settings: Settings) -> RunGroup:
    """Return the responses of runs of one axis that have a recording of the nozzle's sensor.

    All runs are rotated by the same angle so that the sensor looks along the swept axis: at low
    frequencies racking looks like a rotation, too, by another angle at each place. Raises
    IdentificationError.
    """
    commands = [acceleration(run.command[:, run.axis]) for run in runs]
    recorded = [
        aligned(u, run.nozzle, run.axis)
        for u, run in zip(commands, runs, strict=True)
        if run.nozzle is not None
    ]
    triples = list(zip(commands, recorded, runs, strict=True))
    place_mark.check(
        [run.name for run in runs],
        [float(run.command[0, X]) for run in runs],
        [place_mark.answer(u, one.acceleration[:, run.axis]) for u, one, run in triples],
    )
    angles = [heading(u, one.acceleration, run.axis) for u, one, run in triples]
    responses = []
    for u, one, run in triples:
        a = turned(one.acceleration, float(np.mean(angles)))
        along, y = (estimate(u, a[:, k]).within(settings.band_hz) for k in (run.axis, Y))
        place = run.place + settings.offset[X]
        swept = run.command[:, run.axis]
        orders = harmonics(u, a[:, run.axis])
        responses.append(RunResponse(place, along, y, one.uncertainty, swept, orders))
    return with_common_delay(responses)


def bridge_responses(runs: list[Run], settings: Settings) -> RunGroup:
    """Return the racking of runs in x by eq. 3, from the two recordings of the bridge.

    The two may have been recorded one after the other. Raises IdentificationError.
    """
    responses, answers = [], []
    for run in runs:
        if settings.L_G is None:
            raise IdentificationError(
                f"{run.name}: the distance of the bridge's sensors is missing"
            )
        if run.axis != X:
            raise IdentificationError(
                f"{run.name}: this run sweeps y, but only a sweep of x makes the bridge rack"
            )
        u = acceleration(run.command[:, X])
        assert run.bridge is not None
        P1, P2 = (aligned(u, recording, Y) for recording in run.bridge)
        answers.append(place_mark.answer(u, P1.acceleration[:, Y]))
        theta = (P1.acceleration[:, Y] - P2.acceleration[:, Y]) / settings.L_G
        response = estimate(u, theta).within(settings.band_hz)
        late = max(P1.uncertainty, P2.uncertainty)
        responses.append(RunResponse(run.place, response, response, late, run.command[:, X]))
    places = [float(run.command[0, X]) for run in runs]
    place_mark.check([run.name for run in runs], places, answers)
    return with_common_delay(responses)


def with_common_delay(responses: Sequence[RunResponse]) -> RunGroup:
    """Shift each run to the mean delay of all, and bound that delay.

    How much later one run began than another is known far better than when any of them began.
    Each run's bounds hold for all: the more runs, the closer the bounds.
    """
    late = delays([run.response for run in responses])
    runs = [
        replace(run, response=advanced(run.response, by), y=advanced(run.y, by))
        for run, by in zip(responses, late, strict=True)
    ]
    low = max((-run.late - by for run, by in zip(responses, late, strict=True)), default=0.0)
    high = min((run.late - by for run, by in zip(responses, late, strict=True)), default=0.0)
    middle = (low + high) / 2.0
    return RunGroup(runs, (min(low, middle), max(high, middle)))
