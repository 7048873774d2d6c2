"""A printer's plant from sweeps and what accelerometers made of them.

runs → aligned accelerations → frequency responses → transfer functions and x_c

A run moves one axis. A sensor on the nozzle gives Gxx from runs in x and Gyy from runs in y.
Racking comes from two sensors at the ends of the bridge (eq. 3),

    θ'' = (ÿ1 − ÿ2) / L_G,    Gxθ = θ'' / ẍ_d,

or from the nozzle's sensor alone, by runs in x at several places (``lever_arm``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.blas import one_thread
from hframe_post.errors import IdentificationError
from hframe_post.identification.accelerometer import Recording
from hframe_post.identification.alignment import acceleration, aligned, heading, turned
from hframe_post.identification.fit import Fit, fit
from hframe_post.identification.frequency_response import (
    FrequencyResponse,
    Method,
    advanced,
    average,
    delays,
    estimate,
    spread,
)
from hframe_post.identification.lever_arm import Line, centre, line
from hframe_post.model.plant import Plant

AT_REST = {"Gxx": 1.0, "Gyy": 1.0, "Gxtheta": 0.0}  # gain of a plant that stands
PLACES_APART = 20.0  # mm over which places must spread to tell racking
OFF_LINE = 0.3  # of the lever arms' effect, that may lie off the line through the places
DISAGREE = 0.2  # relative, of racking by both ways, that deserves a word
UNSURE = 1e-3  # s of a start that deserve a word
USELESS = 0.2  # of the measurement that a model may leave unexplained at the most
AXES = "xy"


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


@dataclass(frozen=True, slots=True)
class Settings:
    """How to identify. L_G: mm between P1 and P2. orders: of what is not to be chosen."""

    band_hz: tuple[float, float]
    method: Method = "H1"
    L_G: float | None = None
    orders: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Measured:
    """A transfer function as measured: by place (mm of x), together, and how far they differ.

    spread: RMS difference of the places from what they have in common, relative.
    """

    places: list[tuple[float, FrequencyResponse]]
    mean: FrequencyResponse
    spread: float


@dataclass(frozen=True, slots=True)
class Identified:
    """What was found. x_c: None where no runs tell it. arms: racking by the lever arm.

    warnings: of the recordings; those of a fit are in ``fits``.
    """

    measured: dict[str, Measured]
    fits: dict[str, Fit]
    x_c: float | None
    arms: Line | None
    warnings: list[str]

    @property
    def useless(self) -> str | None:
        """Why no profile may be made of it, if a model explains too little."""
        for name, found in self.fits.items():
            if found.residual > USELESS:
                return (
                    f"{name}: a model of order {found.order} leaves {100 * found.residual:.0f} % "
                    "of the measurement unexplained: the order is too low, the printer is not "
                    "linear (loose belts, stiction), or the files are not of one printer"
                )
        return None

    def plant(self, x_c: float) -> Plant:
        """The plant, with ``x_c`` where it was not found."""
        racking = self.fits["Gxtheta"].G if "Gxtheta" in self.fits else None
        known = x_c if self.x_c is None else self.x_c
        return Plant(self.fits["Gxx"].G, self.fits["Gyy"].G, racking, known)


@dataclass(frozen=True, slots=True)
class _Heard:
    """One run as sensors heard it. late: half-width of what is not known of its start, s."""

    place: float
    response: FrequencyResponse
    y: FrequencyResponse
    late: float


@dataclass(frozen=True, slots=True)
class _Together:
    """Runs with one delay in common, and the bounds (s) of it."""

    runs: list[_Heard]
    late: tuple[float, float]


@one_thread()
def identify(runs: Sequence[Run], settings: Settings) -> Identified:
    """Transfer functions and x_c from runs of both axes. Raises IdentificationError."""
    x_runs, y_runs = (
        _nozzle([run for run in runs if run.nozzle and run.axis == axis], settings)
        for axis in (X, Y)
    )
    for name, heard in zip(AXES, (x_runs, y_runs), strict=True):
        if not heard.runs:
            raise IdentificationError(f"no run of the nozzle's sensor sweeps {name}")
    ends = _together([_bridge(run, settings) for run in runs if run.bridge])
    measured, late = {}, {}
    for name, heard in (("Gxx", x_runs), ("Gyy", y_runs), ("Gxtheta", ends)):
        if heard.runs:
            measured[name], late[name] = _measured(heard.runs, settings), heard.late
    fits = {name: _fit(name, measured, settings, late[name]) for name in measured}
    arms = _arms(x_runs.runs)
    if arms and not ends.runs:
        measured["Gxtheta"] = Measured(arms.by_place, arms.slope, arms.off)
        # the same recordings as those of Gxx, so the same delay
        fits["Gxtheta"] = _fit("Gxtheta", measured, settings, (fits["Gxx"].delay,) * 2)
    x_c = centre(arms, measured["Gxx"].mean.H)[0] if arms else None
    warnings = _agreement(arms, measured) if ends.runs else []
    widest = max(high - low for low, high in late.values()) / 2.0
    if widest > UNSURE:
        warnings.append(
            f"the start of a recording is known to ±{widest * 1e3:.1f} ms only: by as much x, y "
            "and racking may be late against one another. Klipper's own files tell the start"
        )
    return Identified(measured, fits, x_c, arms, warnings)


def _nozzle(runs: list[Run], settings: Settings) -> _Together:
    """What the nozzle's sensor heard, turned so that it looks along the swept axis.

    All runs of an axis are turned alike: at low frequencies racking, too, looks like a turn,
    by another angle at each place.
    """
    commands = [acceleration(run.command[:, run.axis]) for run in runs]
    found = [
        aligned(u, run.nozzle, run.axis)
        for u, run in zip(commands, runs, strict=True)
        if run.nozzle is not None
    ]
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
        heard.append(_Heard(_place(run), along, y, one.uncertainty))
    return _together(heard)


def _bridge(run: Run, settings: Settings) -> _Heard:
    """Eq. 3, of two sensors that may have heard the run one after the other."""
    assert run.bridge is not None
    if settings.L_G is None:
        raise IdentificationError(f"{run.name}: the distance of the bridge's sensors is not given")
    if run.axis != X:
        raise IdentificationError(f"{run.name}: racking shows in a run of x, this one sweeps y")
    u = acceleration(run.command[:, X])
    P1, P2 = (aligned(u, recording, Y) for recording in run.bridge)
    theta = (P1.acceleration[:, Y] - P2.acceleration[:, Y]) / settings.L_G
    response = estimate(u, theta, settings.method).within(settings.band_hz)
    return _Heard(_place(run), response, response, max(P1.uncertainty, P2.uncertainty))


def _agreement(arms: Line | None, measured: dict[str, Measured]) -> list[str]:
    """Warnings where racking by the bridge's sensors is not that by the lever arms."""
    if arms is None:
        return []
    bridge, nozzle = measured["Gxtheta"].mean.H, arms.slope.H
    weight = arms.slope.power * arms.slope.coherence
    size = float((weight * np.abs(nozzle) ** 2).sum())
    share = float((weight * bridge * nozzle.conj()).sum().real) / size
    if share < 0.0:
        raise IdentificationError(
            "the bridge's sensors see the gantry turn the other way than the nozzle's sensor: P1 "
            "must be the one at the greater x, and both need their --bridge-axes"
        )
    off = math.sqrt(float((weight * np.abs(bridge - nozzle) ** 2).sum()) / size)
    if off <= DISAGREE:
        return []
    return [
        f"racking by the bridge's sensors is {share:.2f} times that by the nozzle's at several "
        f"places, and {100 * off:.0f} % off: check --bridge-length"
    ]


def _place(run: Run) -> float:
    return float(run.command[:, X].mean())


def _together(heard: list[_Heard]) -> _Together:
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
    return _Together(runs, (min(low, middle), max(high, middle)))


def _measured(heard: list[_Heard], settings: Settings) -> Measured:
    responses = [run.response for run in heard]
    places = [(run.place, run.response) for run in heard]
    return Measured(places, average(responses), spread(responses, settings.band_hz))


def _arms(heard: list[_Heard]) -> Line | None:
    """Racking by the lever arm, where the places are far enough apart."""
    places = [run.place for run in heard]
    if np.ptp(places) < PLACES_APART:
        return None
    found = line(places, [run.y for run in heard])
    if found.off > OFF_LINE:
        raise IdentificationError(
            f"what the nozzle does in y while x sweeps does not grow with the place: "
            f"{100 * found.off:.0f} % of it are off a straight line. Are files of two places "
            "exchanged, or was the sensor moved between runs?"
        )
    return found


def _fit(
    name: str,
    measured: dict[str, Measured],
    settings: Settings,
    late: tuple[float, float],
) -> Fit:
    return fit(
        measured[name].mean, settings.orders.get(name), AT_REST[name], settings.band_hz, late
    )
