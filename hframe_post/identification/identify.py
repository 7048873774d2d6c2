"""The plant of a printer, identified from recordings, and how far it can be trusted.

runs → frequency responses → responses, sensor gains and x_c → what is refused
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hframe_post.errors import IdentificationError
from hframe_post.identification import verdict
from hframe_post.identification.estimation.fit import Fit
from hframe_post.identification.estimation.frequency_response import (
    average,
    share_left,
)
from hframe_post.identification.estimation.measured import (
    AXIS,
    Measured,
    MeasurementSettings,
    Run,
    axis_responses,
)
from hframe_post.identification.estimation.response import fit_known_start, fit_unknown_start
from hframe_post.identification.places import (
    DAY_TO_DAY,
    at_the_middle,
    changes,
    find_racking,
)
from hframe_post.identification.recordings.runs import NEAREST
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.native.linear import one_blas_thread

# standard deviation of all frequencies of an axis from one session to another: 2.0 % on six axes of
# three published printers, 12 minutes to ten weeks later
DRIFT = 0.02
# likewise of a response that does not say what is unknown of it, which this must cover, too. With
# it the error of 23 of 24 rectangles and strokes, 12 minutes or 18 days later on two printers, was
# in the predicted range, with 0.02 that of 15; the commands were as good
DRIFT_ALONE = 0.03
BY_SHIFT = 5.0  # times the relative shift of a mode is the change of the response, usually
RIGID = ImpulseResponse(np.zeros(1), 0)


@dataclass(frozen=True, slots=True)
class Identified:
    """What was identified.

    measured, fits: by name, Gxx, Gyy and, if measured, Gxtheta. x_c: mm, None if no runs tell it.
    racks: whether the kinematics can rack. racking_below_noise: racking was looked for and is less
    than its noise. repetitions: by name, of axes that were recorded more than once at one place,
    the share of the response that each recording has of its own.
    """

    measured: dict[str, Measured]
    fits: dict[str, Fit]
    x_c: float | None
    racks: bool
    racking_below_noise: bool
    repetitions: dict[str, float]

    @property
    def model_error(self) -> float:
        """Return the uncertainty of the model; what changes from day to day is assumed, unless
        every axis was recorded more than once."""
        shares = [share / BY_SHIFT for share in self.repetitions.values()]
        known = self.repetitions.keys() >= set(self.axes)
        return max([DRIFT if known else DAY_TO_DAY, *shares])

    @property
    def axes(self) -> list[str]:
        """Return the names of the axes that were identified, Gxx first."""
        return [name for name in AXIS if name in self.fits]

    @property
    def gains(self) -> dict[str, float]:
        """Return the sensor's reading per mm/s² along each axis."""
        return {AXIS[name]: self.fits[name].gain for name in self.axes}

    @property
    def refusal(self) -> str | None:
        """Return why the models are too poor for a profile, or None if they are good enough."""
        cause = self.changes or "check that nothing is loose and that all files are of one printer"
        for name in self.axes:
            measured, found = self.measured[name], self.fits[name]
            if not measured.known_start and measured.repeated > verdict.SPREAD:
                return (
                    f"the recordings of {AXIS[name]} differ from each other by "
                    f"{100 * measured.repeated:.0f} %, more than {100 * verdict.SPREAD:.0f} %. "
                    "They are of two printers, of one that was changed in between, or of other "
                    "motions than their names say: identify each by itself"
                )
            off, struck = abs(found.gain - 1.0), measured.known_start
            bound = verdict.GAIN_ERROR_STROKES if struck else verdict.GAIN_ERROR_TEST
            if off > bound:
                return (
                    f"the sensor would have to read {100 * off:.0f} % wrong in {AXIS[name]}, more "
                    f"than the {100 * bound:g} % that sensors do: {cause}"
                )
            if found.residual > verdict.UNEXPLAINED:
                return (
                    f"the model of {name} leaves {100 * found.residual:.0f} % of the measurement "
                    f"unexplained (at most {100 * verdict.UNEXPLAINED:.0f} %): {cause}"
                )
        return None

    @property
    def changes(self) -> str:
        """Return by how much x varies between positions, if one model cannot describe all."""
        x = self.measured.get("Gxx")
        if x is None or "Gxx" in self.repetitions or not changes(x):
            return ""
        return (
            f"Gxx varies by {100 * x.spread:.0f} % between the gantry's positions; one model "
            "cannot describe all of them"
        )

    def plant(self, x_c: float) -> Plant:
        """Return the plant; ``x_c`` (mm) is used if it was not identified.

        An axis that was not measured is taken to follow its command exactly. One whose response was
        measured is expected to drift.
        """
        found: dict[str, ImpulseResponse] = {name: fit.G for name, fit in self.fits.items()}
        for name in self.axes:
            G = self.fits[name].G
            found[name] = replace(G, drift=DRIFT if len(G.unknown) else DRIFT_ALONE)
        known = x_c if self.x_c is None else self.x_c
        Gxx, Gyy = (found.get(name, RIGID) for name in AXIS)
        return Plant(Gxx, Gyy, found.get("Gxtheta"), known)


__all__ = ["AXIS", "Identified", "Measured", "MeasurementSettings", "Run", "identify"]


@one_blas_thread()
def identify(runs: Sequence[Run], settings: MeasurementSettings) -> Identified:
    """Return transfer functions and x_c from runs of x, of y, or of both.

    Raises IdentificationError.
    """
    if not runs:
        raise IdentificationError("no run of the nozzle's sensor. Give one with --nozzle")
    measured = axis_responses(runs, settings)
    fits = _fit_all(measured)
    repeated = {name: _repetition(one) for name, one in measured.items()}
    repetitions = {name: one for name, one in repeated.items() if one is not None}
    racking, sought = None, False
    if "Gxx" in measured:
        racking, sought = find_racking(measured["Gxx"], fits, settings)
    x_c = None
    if racking is not None:
        measured["Gxtheta"], fits["Gxtheta"], x_c = racking.measured, racking.fit, racking.x_c
    below_noise = sought and racking is None
    return Identified(measured, fits, x_c, settings.racks, below_noise, repetitions)


def _fit_all(measured: Mapping[str, Measured]) -> dict[str, Fit]:
    others = {name: one for name, one in measured.items() if not one.known_start}
    fits = fit_unknown_start({name: average(one.excited()) for name, one in others.items()})
    fits |= {
        name: fit_known_start(at_the_middle(one.places) if changes(one) else one.mean)
        for name, one in measured.items()
        if one.known_start
    }
    return {name: fits[name] for name in measured}


def _repetition(measured: Measured) -> float | None:
    """Return the share of the response that one recording does not foresee of another, over √2.

    They are of the place that was recorded most often; None if none was repeated.

    Runs of our own sweep follow one another within minutes, which tells nothing of a day.
    """
    if measured.known_start:
        return None
    at = np.array([place for place, _ in measured.places])
    near = max((np.abs(at - place) < NEAREST for place in at), key=np.count_nonzero)
    if np.count_nonzero(near) < 2:
        return None
    runs = [run for run, chosen in zip(measured.excited(), near, strict=True) if chosen]
    shares = [share_left(one.H, other, other.power) for one, other in pairwise(runs)]
    return float(np.mean(shares)) / math.sqrt(2.0)
