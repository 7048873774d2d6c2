"""Runs of a sweep, and what sensors heard of them: frequency responses by place.

runs → aligned accelerations → frequency responses, each delayed alike

A run moves one axis. A sensor on the nozzle gives Gxx from runs in x and Gyy from runs in y.
Racking comes from two sensors at the ends of the bridge (eq. 3),

    θ'' = (ÿ1 − ÿ2) / L_G,    Gxθ = θ'' / ẍ_d,

or from the nozzle's sensor alone, by runs in x at several places (``lever_arm``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings import place_mark
from hframe_post.identification.recordings.accelerometer import Recording
from hframe_post.identification.recordings.alignment import acceleration, aligned, heading, turned
from hframe_post.identification.responses.frequency_response import (
    FrequencyResponse,
    Method,
    advanced,
    delays,
    estimate,
)
from hframe_post.identification.responses.harmonics import Harmonics, harmonics

STEP = 0.02  # mm of belt, of motors of which nothing is known


@dataclass(frozen=True, slots=True)
class Run:
    """One sweep. command (m, 2): x, y in mm, every 1 ms; the recordings in the printer's axes.

    bridge: the sensors at P1, of greater x, and at P2.
    """

    name: str
    command: Array
    nozzle: Recording | None = None
    bridge: tuple[Recording, Recording] | None = None

    @property
    def axis(self) -> int:
        """X or Y, the one that moves. Raises IdentificationError unless one does."""
        moving = np.flatnonzero(np.ptp(self.command, axis=0) > 0.0)
        if len(moving) != 1:
            cause = "both axes move" if len(moving) else "nothing moves"
            raise IdentificationError(f"{self.name}: {cause}; a run sweeps x or y alone")
        return int(moving[0])

    @property
    def place(self) -> float:
        """Where it was played, mm of x."""
        return float(self.command[:, X].mean())


@dataclass(frozen=True, slots=True)
class Settings:
    """How to identify. L_G: mm between P1 and P2. orders: of what is not to be chosen.

    racks: whether the kinematics can. offset: from the nozzle to its sensor in x and y, mm.
    step: mm of belt, of the motors. sensor: its gains along x and y, where gravity told them.
    """

    band_hz: tuple[float, float]
    method: Method = "H1"
    L_G: float | None = None
    orders: dict[str, int] = field(default_factory=dict)
    racks: bool = True
    offset: tuple[float, float] = (0.0, 0.0)
    step: float = STEP
    sensor: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Heard:
    """One run as sensors heard it. late: half-width of what is not known of its start, s.

    y: across, where the nozzle's sensor heard it. command (m,): mm along the swept axis.
    harmonics: None where they cannot be told.
    """

    place: float
    response: FrequencyResponse
    y: FrequencyResponse
    late: float
    command: Array
    harmonics: Harmonics | None = None


@dataclass(frozen=True, slots=True)
class Together:
    """Runs with one delay in common, and the bounds (s) of it."""

    runs: list[Heard]
    late: tuple[float, float]


def by_nozzle(runs: list[Run], settings: Settings) -> Together:
    """What the nozzle's sensor heard, turned so that it looks along the swept axis.

    All runs of an axis are turned alike: at low frequencies racking, too, looks like a turn,
    by another angle at each place. Raises IdentificationError.
    """
    commands = [acceleration(run.command[:, run.axis]) for run in runs]
    found = [
        aligned(u, run.nozzle, run.axis)
        for u, run in zip(commands, runs, strict=True)
        if run.nozzle is not None
    ]
    answers = [
        place_mark.answer(u, one.acceleration[:, run.axis])
        for u, one, run in zip(commands, found, runs, strict=True)
    ]
    _check_places(runs, answers)
    angles = [
        heading(u, one.acceleration, run.axis)
        for u, one, run in zip(commands, found, runs, strict=True)
    ]
    heard = []
    for u, one, run in zip(commands, found, runs, strict=True):
        a = turned(one.acceleration, float(np.mean(angles)))
        along, y = (
            estimate(u, a[:, channel], settings.method).within(settings.band_hz)
            for channel in (run.axis, Y)
        )
        orders = harmonics(u, a[:, run.axis])
        own = run.command[:, run.axis]
        place = run.place + settings.offset[X]
        heard.append(Heard(place, along, y, one.uncertainty, own, orders))
    return together(heard)


def _check_places(runs: list[Run], answers: list[place_mark.Answer | None]) -> None:
    places = [float(run.command[0, X]) for run in runs]
    place_mark.check([run.name for run in runs], places, answers)


def by_bridge(runs: list[Run], settings: Settings) -> Together:
    """Eq. 3, of two sensors that may have heard a run one after the other."""
    heard, answers = [], []
    for run in runs:
        if settings.L_G is None:
            raise IdentificationError(
                f"{run.name}: the distance of the bridge's sensors is not given"
            )
        if run.axis != X:
            raise IdentificationError(f"{run.name}: racking shows in a run of x, this one sweeps y")
        u = acceleration(run.command[:, X])
        assert run.bridge is not None
        P1, P2 = (aligned(u, recording, Y) for recording in run.bridge)
        answers.append(place_mark.answer(u, P1.acceleration[:, Y]))
        theta = (P1.acceleration[:, Y] - P2.acceleration[:, Y]) / settings.L_G
        response = estimate(u, theta, settings.method).within(settings.band_hz)
        late = max(P1.uncertainty, P2.uncertainty)
        heard.append(Heard(run.place, response, response, late, run.command[:, X]))
    _check_places(runs, answers)
    return together(heard)


def together(heard: Sequence[Heard]) -> Together:
    """The runs, each shifted to the delay of their mean.

    How much later one began than another is known far better than when any began. Each run's
    bounds hold for all: the more runs, the closer.
    """
    late = delays([run.response for run in heard])
    runs = [
        replace(run, response=advanced(run.response, by), y=advanced(run.y, by))
        for run, by in zip(heard, late, strict=True)
    ]
    low = max((-run.late - by for run, by in zip(heard, late, strict=True)), default=0.0)
    high = min((run.late - by for run, by in zip(heard, late, strict=True)), default=0.0)
    middle = (low + high) / 2.0
    return Together(runs, (min(low, middle), max(high, middle)))
