"""Random printers that differ a little from the model.

Each response takes more or less time, as it does when a belt gets tighter or a carriage heavier,
and decays faster or slower. A nozzle at rest stays where its steps put it; only the gain of
racking is random.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import ArgumentError
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant


def draws(plant: Plant, share: float, count: int, seed: int) -> list[Plant]:
    """Return ``count`` random plants, parameters off by up to ``share`` (0.05: ±5 %), uniformly.

    Equal seeds give the same printers at every share, only farther off. Raises ArgumentError for
    a share that is not from 0 to below 1.
    """
    if not 0.0 <= share < 1.0:
        raise ArgumentError(f"a model error is a share from 0 to below 1, not {share:g}")
    rng = np.random.default_rng(seed)
    units = rng.uniform(-1.0, 1.0, (count, 3, 3))  # draw, transfer function, parameter
    return [perturbed(plant, 1.0 + share * unit) for unit in units]


def perturbed(plant: Plant, factors: Array) -> Plant:
    """Return the plant with factors (3, 3) on frequency, damping and gain of Gxx, Gyy and Gxθ."""
    (fx, dx, _), (fy, dy, _), theta = factors.tolist()
    Gxx, Gyy = _moved(plant.Gxx, fx, dx), _moved(plant.Gyy, fy, dy)
    Gxtheta = plant.Gxtheta and _moved(plant.Gxtheta, *theta)
    return replace(plant, Gxx=Gxx, Gyy=Gyy, Gxtheta=Gxtheta)


def _moved(
    G: ImpulseResponse, frequency: float, damping: float, gain: float = 1.0
) -> ImpulseResponse:
    """Return a response with other frequencies and decays of its modes, each times a factor.

    The lag is a damper's, too.
    """
    moved = G.stretched(1.0 / frequency).damped(damping)
    return replace(moved, deviation=gain * moved.deviation, lag=gain * (damping * moved.lag))
