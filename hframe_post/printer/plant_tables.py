"""The table [plant] of a profile or a model: its responses, checked completely."""

from __future__ import annotations

from typing import Any

import numpy as np

from hframe_post.arrays import TS
from hframe_post.errors import ArgumentError, PrinterError
from hframe_post.model.impulse_response import LONGEST, ImpulseResponse
from hframe_post.model.kinematics import Kinematics
from hframe_post.model.plant import Bed, Plant
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.printer.schema import (
    checked_value,
    known_keys,
    needed_keys,
    numbers,
    roots,
)
from hframe_post.printer.settings import PLACES, SHARE, Limits

PLANT = ("Ts", "x_c", "invented", "uncertainty", "measured", "moving_mass")
MASS = {"least": 0.05, "most": 50.0}  # kg
FUNCTION = ("zeros", "poles", "gain")
RESPONSE = ("deviation", "lead")
KNOWN = ("lag", "drift", "unknown")  # of a response, too, if they are not 0
MICRORAD = 1e-3  # rad per mm/sample² in which 1000 mm/s² during 1 ms cause 1 µrad
DEVIATIONS = {"least": -1e6, "most": 1e6}  # µm or µrad
LAGS = {"least": -1e3, "most": 1e3}  # ms, or µrad at 1 mm/s


def read_plant(table: dict[str, Any]) -> Plant:
    """Return the plant of [plant], without its bed. Raises PrinterError."""
    known_keys(table, (*PLANT, "Gxx", "Gyy", "Gxtheta"), "plant")
    needed_keys(table, ("Ts", "Gxx", "Gyy", *(("x_c",) if "Gxtheta" in table else ())), "plant")
    if table["Ts"] != TS:
        raise PrinterError(f"must be {TS}: the clock runs in milliseconds", "plant.Ts")
    functions = {
        key: _linear(table[key], f"plant.{key}", rest, angle)
        for key, rest, angle in (("Gxx", 1.0, False), ("Gyy", 1.0, False), ("Gxtheta", 0.0, True))
        if key in table
    }
    racking = functions.get("Gxtheta")
    if racking is not None and not np.append(racking.deviation, racking.lag).any():
        racking = None
    x_c = checked_value(float, table.get("x_c", 0.0), PLACES, "plant.x_c")
    return Plant(functions["Gxx"], functions["Gyy"], racking, x_c)


def read_bed(mass: Any, limits: Limits, kinematics: Kinematics) -> Bed | None:
    """Return the bed that moves with this mass, kg; None without one. Raises PrinterError."""
    if mass is None:
        return None
    if not kinematics.bed_moves:
        cause = f"the bed of a {kinematics.type} printer does not move in y: leave it out"
        raise PrinterError(cause, "plant.moving_mass")
    mass = checked_value(float, mass, MASS, "plant.moving_mass")
    return Bed(mass, limits.filament_mass)


def _linear(table: Any, key: str, rest: float, angle: bool) -> ImpulseResponse:
    """Return a response with this gain at rest, written as such or as a transfer function.

    angle: the response is one in rad, to a command in mm.
    """
    if not isinstance(table, dict):
        raise PrinterError(
            "must be a table of deviation and lead, or of zeros, poles and gain", key
        )
    known_keys(table, (*FUNCTION, *RESPONSE, *KNOWN), key)
    response = any(name in table for name in (*RESPONSE, *KNOWN))
    kind, allowed = (RESPONSE, (*RESPONSE, *KNOWN)) if response else (FUNCTION, FUNCTION)
    for name in table:
        if name not in allowed:
            cause = "is of a transfer function, and deviation of a response: leave one of them out"
            raise PrinterError(cause, f"{key}.{name}")
    needed_keys(table, kind, key)
    try:
        if response:
            return _response(table, key, rest, MICRORAD if angle else 1.0)
        zeros, poles = (roots(table[name], f"{key}.{name}") for name in ("zeros", "poles"))
        gain = checked_value(float, table["gain"], {}, f"{key}.gain")
        return ImpulseResponse.from_transfer_function(TransferFunction(zeros, poles, gain), rest)
    except ArgumentError as error:
        raise PrinterError(str(error), key) from None


def _response(table: dict[str, Any], key: str, rest: float, unit: float) -> ImpulseResponse:
    deviation = numbers(table["deviation"], LONGEST, DEVIATIONS, f"{key}.deviation")
    lead = checked_value(int, table["lead"], {}, f"{key}.lead")
    lag = checked_value(float, table.get("lag", 0.0), LAGS, f"{key}.lag")
    drift = checked_value(float, table.get("drift", 0.0), SHARE, f"{key}.drift")
    unknown = np.zeros(0)
    if "unknown" in table:
        unknown = numbers(table["unknown"], LONGEST, DEVIATIONS, f"{key}.unknown")
    return ImpulseResponse(deviation * unit, lead, rest, lag * unit, drift, unknown * unit)
