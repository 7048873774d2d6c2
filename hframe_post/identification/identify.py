"""A printer's plant from sweeps and what accelerometers made of them.

runs → frequency responses (`heard`) → transfer functions, the sensor's gains and x_c
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification.diagnosis.along_x import ModeShift, find_mode_shift, position_spread
from hframe_post.identification.diagnosis.causes import Linear
from hframe_post.identification.diagnosis.linearity import Nonlinearity, Swept, nonlinearity
from hframe_post.identification.diagnosis.uncertainty import (
    DAILY,
    MOST,
    SIGMAS,
    Uncertainty,
    lever_arm_uncertainty,
    model_uncertainty,
)
from hframe_post.identification.fitting.fit import Fit, at_one_time, fit, with_gain
from hframe_post.identification.fitting.weighting import Distortion
from hframe_post.identification.recordings.accelerometer import GAIN_SD
from hframe_post.identification.responses.frequency_response import (
    FrequencyResponse,
    average,
    spread,
)
from hframe_post.identification.responses.lever_arm import Line, centre, line
from hframe_post.identification.responses.measured import (
    Run,
    RunGroup,
    RunResponse,
    Settings,
    bridge_responses,
    nozzle_responses,
)
from hframe_post.model.plant import Plant
from hframe_post.resources import one_blas_thread

AT_REST = {"Gxx": 1.0, "Gyy": 1.0, "Gxtheta": 0.0}  # gain of a plant that stands
PLACES_APART = 20.0  # mm over which places must spread to tell racking
OFF_LINE = 0.3  # of the lever arms' effect, that may lie off the line through the places
RACKS = 1.0  # times its noise, in power, from which racking is one where places are on a line,
CLEARLY_RACKS = 3.0  # and from which it is one in any case
DISAGREE = 0.2  # relative, of racking by both ways, that deserves a word
UNSURE = 1e-3  # s of a start that deserve a word
USELESS = 0.35  # of the measurement that a model may leave unexplained at the most
NONLINEAR = 0.25  # the same of a printer that is not linear,
BEYOND = 2.0  # where it is so many times what noise and harmonics make of it,
BENT = 0.6  # and where it is not
MOST_GAIN = 0.075  # of a sensor, relative: what it may read wrong
SMEARED = 0.1  # of a response, by which places may differ and its mean be one printer's
ROUNDS = 2  # the linear part and what is not linear, each told by the other
AXES, AXIS = "xy", {"Gxx": "x", "Gyy": "y"}

__all__ = ["Identified", "Measured", "Run", "Settings", "identify"]


@dataclass(frozen=True, slots=True)
class Measured:
    """A transfer function as measured: by place (mm of x), together, and how far they differ.

    spread: RMS difference of the places from what they have in common, relative. late: bounds
    (s) of the recordings' delay.
    """

    places: list[tuple[float, FrequencyResponse]]
    mean: FrequencyResponse
    spread: float
    late: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Identified:
    """What was found. x_c: None where no runs tell it. arms: racking by the lever arm.

    warnings: of the recordings; those of a fit are in ``fits``. racks: whether the kinematics
    can. silent: racking was looked for,
    and is less than its own uncertainty. moving: how Gxx changes along x. nonlinear: what the
    sweep's harmonics tell. certain: how well each function is known; centred: standard deviations
    of x_c (mm) and racking (relative).
    """

    measured: dict[str, Measured]
    fits: dict[str, Fit]
    x_c: float | None
    arms: Line | None
    warnings: list[str]
    racks: bool
    racking_below_noise: bool
    mode_shift: ModeShift | None
    nonlinearity: Nonlinearity | None
    uncertainties: dict[str, Uncertainty]
    lever_arm_sd: tuple[float, float] | None

    @property
    def model_error(self) -> float:
        """Share by which the printer may differ from the model."""
        shares = [
            DAILY,
            *(one.share for name, one in self.uncertainties.items() if name != "Gxtheta"),
        ]
        if self.lever_arm_sd is not None:
            shares.append(min(SIGMAS * self.lever_arm_sd[1], MOST))
        return max(shares)

    @property
    def gains(self) -> dict[str, float]:
        """What the sensor reads of 1 mm/s² along each of the printer's axes."""
        return {axis: self.fits[name].gain for axis, name in zip(AXES, ("Gxx", "Gyy"), strict=True)}

    @property
    def refusal(self) -> str | None:
        """Why no profile may be made of it, if a model explains too little."""
        for axis, gain in self.gains.items():
            if abs(gain - 1.0) > MOST_GAIN:
                return (
                    f"the sensor would read {100 * abs(gain - 1.0):.0f} % wrong in {axis}, more "
                    f"than sensors do: {self._cause}"
                )
        for name, found in self.fits.items():
            most = USELESS
            if self.nonlinearity is not None:
                most = NONLINEAR if found.residual_over_noise > BEYOND else BENT
            if found.residual > most and name != "Gxtheta":
                return (
                    f"{name}: a model of order {found.order} leaves {100 * found.residual:.0f} % "
                    f"of the measurement unexplained: {self._cause}"
                )
        return None

    @property
    def _cause(self) -> str:
        """Why a model is no good."""
        if self.nonlinearity is not None:
            return self.nonlinearity.message
        if self.mode_shift is not None:
            return f"{self.mode_shift.message}, too far for one model"
        return "the order is too low, or the files are not of one printer"

    def plant(self, x_c: float) -> Plant:
        """The plant, with ``x_c`` where it was not found."""
        racking = self.fits["Gxtheta"].G if "Gxtheta" in self.fits else None
        known = x_c if self.x_c is None else self.x_c
        return Plant(self.fits["Gxx"].G, self.fits["Gyy"].G, racking, known)

    def plants_at_ends(self, x_c: float) -> list[Plant]:
        """The plant at the least and the greatest x, where it changes along x."""
        plant = self.plant(x_c)
        return [replace(plant, Gxx=G) for G in self.mode_shift.at_ends] if self.mode_shift else []


@one_blas_thread()
def identify(runs: Sequence[Run], settings: Settings) -> Identified:
    """Transfer functions and x_c from runs of both axes. Raises IdentificationError."""
    x_runs, y_runs = (_swept(runs, axis, settings) for axis in (X, Y))
    ends = bridge_responses([run for run in runs if run.bridge], settings)
    measured = {"Gxx": _measured(x_runs, settings), "Gyy": _measured(y_runs, settings)}
    fits = {name: _fit(name, one, settings) for name, one in measured.items()}
    nonlinear = _nonlinear(x_runs, y_runs, fits, settings.step)
    for _ in range(ROUNDS if nonlinear else 0):
        bent = nonlinear.distortions if nonlinear else {}
        fits = {
            name: _fit(name, one, settings, bent.get(AXIS[name])) for name, one in measured.items()
        }
        nonlinear = _nonlinear(x_runs, y_runs, fits, settings.step) or nonlinear
    along = nonlinear.distortions.get("x") if nonlinear else None
    if nonlinear is None:
        smeared = {name: one for name, one in measured.items() if one.spread > SMEARED}
        for name, one in smeared.items():
            fits[name] = _fit(name, one, settings, position_spread([run for _, run in one.places]))
    fits = dict(zip(fits, at_one_time(*fits.values()), strict=True))
    along_x = find_mode_shift(fits["Gxx"], measured["Gxx"].places, settings.band_hz)
    arms = _arms(x_runs.runs, settings, along_x is not None)
    racking = arms is not None and _racks(arms)
    if ends.runs:
        measured["Gxtheta"] = _measured(ends, settings)
        fits["Gxtheta"] = _fit("Gxtheta", measured["Gxtheta"], settings, along)
    elif arms and racking:
        # the same recordings as those of Gxx, so the same delay
        late = (fits["Gxx"].recording_delay,) * 2
        measured["Gxtheta"] = Measured(arms.by_place, arms.slope, arms.off, late)
        found = _fit("Gxtheta", measured["Gxtheta"], settings, along)
        fits["Gxtheta"] = with_gain(found, fits["Gyy"].gain)
    x_c = centre(arms, measured["Gxx"].mean.H)[0] if arms and racking else None
    return Identified(
        measured, fits, x_c, arms if racking else None, _warnings(arms, ends, measured),
        settings.racks, arms is not None and not racking, along_x, nonlinear,
        _certain(fits, measured, settings),
        _centred(x_runs, measured["Gxx"]) if arms and racking else None,
    )  # fmt: skip


def _certain(
    fits: dict[str, Fit], measured: dict[str, Measured], settings: Settings
) -> dict[str, Uncertainty]:
    known = {
        name: model_uncertainty(found, [run for _, run in measured[name].places], settings.band_hz)
        for name, found in fits.items()
    }
    return {name: one for name, one in known.items() if one is not None}


def _centred(x_runs: RunGroup, along: Measured) -> tuple[float, float]:
    heard = x_runs.runs
    return lever_arm_uncertainty([run.place for run in heard], [run.y for run in heard], along.mean)


def _swept(runs: Sequence[Run], axis: int, settings: Settings) -> RunGroup:
    """What the nozzle's sensor heard of the runs along an axis, of which there must be one."""
    heard = nozzle_responses([run for run in runs if run.nozzle and run.axis == axis], settings)
    if not heard.runs:
        raise IdentificationError(f"no run of the nozzle's sensor sweeps {AXES[axis]}")
    return heard


def _warnings(arms: Line | None, ends: RunGroup, measured: dict[str, Measured]) -> list[str]:
    warnings = _agreement(arms, measured) if ends.runs else []
    widest = max(one.late[1] - one.late[0] for one in measured.values()) / 2.0
    if widest > UNSURE:
        warnings.append(
            f"the start of a recording is known to ±{widest * 1e3:.1f} ms only: by as much x, y "
            "and racking may be late against one another. Klipper's own files tell the start"
        )
    return warnings


def _nonlinear(
    x_runs: RunGroup, y_runs: RunGroup, fits: dict[str, Fit], step: float
) -> Nonlinearity | None:
    axes = {}
    for name, heard in (("Gxx", x_runs), ("Gyy", y_runs)):
        found = fits[name]
        known = [(run.command, run.harmonics) for run in heard.runs if run.harmonics is not None]
        if known:
            printer = Linear(
                found.response, found.gain, found.recording_delay + found.printer_delay
            )
            axes[AXIS[name]] = Swept(known, printer)
    return nonlinearity(axes, step)


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
            "must be the one at the greater x, and both need their own --axes"
        )
    off = math.sqrt(float((weight * np.abs(bridge - nozzle) ** 2).sum()) / size)
    if off <= DISAGREE:
        return []
    return [
        f"racking by the bridge's sensors is {share:.2f} times that by the nozzle's at several "
        f"places, and {100 * off:.0f} % off: check --bridge-length"
    ]


def _measured(heard: RunGroup, settings: Settings) -> Measured:
    responses = [run.response for run in heard.runs]
    places = [(run.place, run.response) for run in heard.runs]
    return Measured(
        places, average(responses), spread(responses, settings.band_hz), heard.delay_bounds
    )


def _arms(heard: list[RunResponse], settings: Settings, changes: bool) -> Line | None:
    """Racking by the lever arm, where it can be and the places are far enough apart.

    changes: whether the printer changes along x, so that no line is straight.
    """
    places = [run.place for run in heard]
    if not settings.racks or np.ptp(places) < PLACES_APART:
        return None
    found = line(places, [run.y for run in heard])
    if found.over_noise <= CLEARLY_RACKS or changes or found.beyond_noise <= OFF_LINE:
        return found
    raise IdentificationError(
        f"what the nozzle does in y while x sweeps does not grow with the place: "
        f"{100 * found.beyond_noise:.0f} % of it are off a straight line. "
        "Are files of two places exchanged, or was the sensor moved between runs?"
    )


def _racks(arms: Line) -> bool:
    return arms.over_noise > (RACKS if arms.beyond_noise <= OFF_LINE else CLEARLY_RACKS)


def _fit(
    name: str, measured: Measured, settings: Settings, distortion: Distortion | None = None
) -> Fit:
    runs = [response for _, response in measured.places]
    return fit(
        runs, measured.mean, None, AT_REST[name], settings.band_hz,
        measured.late, distortion, _sensor(name, settings),
    )  # fmt: skip


def _sensor(name: str, settings: Settings) -> tuple[float, float] | None:
    """The gain that gravity told, with its standard deviation."""
    if settings.sensor is None or name == "Gxtheta":
        return None
    return settings.sensor[("Gxx", "Gyy").index(name)], GAIN_SD
