"""What was identified: responses as measured, models, and how far they can be trusted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from hframe_post.identification.coupling import MeasuredCoupling
from hframe_post.identification.estimation.axes import Fit, Measured
from hframe_post.identification.places import DAY_TO_DAY, MOST, ModeShift
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant

STROKES_OFF, OFF = 0.075, 0.35  # of a sensor's gain: accel_per_hz may be wrong, too
MOST_LEFT = 0.6  # of a measurement, by the model: of an SV08 after ten weeks 0.52
OTHER_PRINTER = 0.4  # spread of an axis; a printer that was used for ten weeks: 0.3
LEAST_CHANGE = 0.02  # relative, that is assumed of a printer that repeats itself
# standard deviation of all frequencies of an axis from one session to another: 2.0 % on six axes of
# three published printers, 12 minutes to ten weeks later
DRIFT = 0.02
# likewise of a response that does not say what is unknown of it, which this must cover, too. With
# it the error of 23 of 24 rectangles and strokes, 12 minutes or 18 days later on two printers, was
# in the predicted range, with 0.02 that of 15; the commands were as good
DRIFT_ALONE = 0.03
BY_SHIFT = 5.0  # times the relative shift of a mode is the change of the response, usually
AXIS = {"Gxx": "x", "Gyy": "y"}
RIGID = ImpulseResponse(np.zeros(1), 0)


@dataclass(frozen=True, slots=True)
class Identified:
    """What was identified.

    measured, fits: by name, Gxx, Gyy and, if measured, Gxtheta. x_c: mm, None if no
    runs tell it. warnings: about recordings; those about a model are in ``fits``. racks: whether
    the kinematics can rack. racking_below_noise: racking was looked for and is less than its
    noise. mode_shift: how Gxx changes along x. repetitions: by name, of axes that were recorded
    more than once at one place, the share of the response that each recording has of its own.
    couplings: what x and y do to each other. lever_arm_sd: standard deviations of x_c (mm) and of
    racking (relative), if racking was found by the lever arm.
    """

    measured: dict[str, Measured]
    fits: dict[str, Fit]
    x_c: float | None
    warnings: list[str]
    racks: bool
    racking_below_noise: bool
    mode_shift: ModeShift | None
    lever_arm_sd: tuple[float, float] | None
    repetitions: dict[str, float]
    couplings: list[MeasuredCoupling]

    @property
    def along_x(self) -> dict[str, ImpulseResponse]:
        """Return the responses that change along x, by name."""
        return {name: found.G for name, found in self.fits.items() if found.G.elsewhere}

    @property
    def model_error(self) -> float:
        """Return the uncertainty of the model; what changes from day to day is assumed, unless
        every axis was recorded more than once."""
        shares = [min(2.0 * self.lever_arm_sd[1], MOST)] if self.lever_arm_sd else []
        shares += [min(share / BY_SHIFT, MOST) for share in self.repetitions.values()]
        known = self.repetitions.keys() >= AXIS.keys() & self.fits.keys()
        return max([LEAST_CHANGE if known else DAY_TO_DAY, *shares])

    @property
    def gains(self) -> dict[str, float]:
        """Return the sensor's reading per mm/s² along each axis."""
        return {axis: self.fits[name].gain for name, axis in AXIS.items() if name in self.fits}

    @property
    def refusal(self) -> str | None:
        """Return why the models are too poor for a profile, or None if they are good enough."""
        for name in AXIS.keys() & self.fits.keys():
            measured = self.measured[name]
            if measured.resonance_hz is not None and measured.repeated > OTHER_PRINTER:
                return (
                    f"the recordings of {AXIS[name]} differ from each other by "
                    f"{100 * measured.repeated:.0f} %. They are of two printers, of one that was "
                    "changed in between, or of other motions than their names say: identify each "
                    "by itself"
                )
        for name in AXIS.keys() & self.fits.keys():
            off, struck = abs(self.fits[name].gain - 1.0), self.measured[name].known_start
            if off > (STROKES_OFF if struck else OFF):
                return (
                    f"the sensor would have to read {100 * off:.0f} % wrong in {AXIS[name]}, more "
                    f"than sensors do: {self._cause}"
                )
        for name in AXIS.keys() & self.fits.keys():
            found = self.fits[name]
            if found.residual > MOST_LEFT:
                return (
                    f"the model of {name} leaves {100 * found.residual:.0f} % of the measurement "
                    f"unexplained: {self._cause}"
                )
        return None

    @property
    def _cause(self) -> str:
        if self.mode_shift is not None:
            return f"{self.mode_shift.message}, too far for a single model"
        return "check that nothing is loose and that all files are of one printer"

    def plant(self, x_c: float) -> Plant:
        """Return the plant; ``x_c`` (mm) is used if it was not identified.

        An axis that was not measured is taken to follow its command exactly. One whose response was
        measured is expected to drift.
        """
        found: dict[str, ImpulseResponse] = {name: fit.G for name, fit in self.fits.items()}
        for name in AXIS.keys() & found.keys():
            G = self.fits[name].G
            found[name] = replace(G, drift=DRIFT if len(G.unknown) else DRIFT_ALONE)
        known = x_c if self.x_c is None else self.x_c
        Gxx, Gyy = (found.get(name, RIGID) for name in AXIS)
        cross = chain.from_iterable(one.terms for one in self.couplings)
        return Plant(Gxx, Gyy, found.get("Gxtheta"), known, tuple(cross))
