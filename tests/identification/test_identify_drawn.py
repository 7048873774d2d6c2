"""Identification of random printers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import TS
from hframe_post.model.plant import Plant
from hframe_post.model.transfer_function import TransferFunction
from tests.identification.bench import Bench, check_recovered
from tests.plants import as_response


def resonance(hz: float, damping: float) -> tuple[complex, complex]:
    s = 2.0 * np.pi * hz * complex(-damping, math.sqrt(1.0 - damping**2))
    pole = complex(np.exp(s * TS))
    return pole, pole.conjugate()


def random_plant(seed: int) -> Plant:
    """Return a plant of resonances of 20 to 90 Hz, damped by 0.03 to 0.3, behind a motor's lag."""
    rng = np.random.default_rng(seed)

    def mode() -> tuple[complex, complex]:
        return resonance(rng.uniform(20.0, 90.0), rng.uniform(0.03, 0.3))

    def at_rest(zeros: Sequence[complex], poles: Sequence[complex]) -> TransferFunction:
        G = TransferFunction(np.array(zeros), np.array(poles), 1.0)
        return replace(G, gain=1.0 / G.dc_gain)

    lag = math.exp(-2.0 * np.pi * rng.uniform(40.0, 120.0) * TS)
    Gxx, Gyy = (at_rest([lag * 0.5], [*mode(), lag]) for _ in "xy")
    poles = np.array([*mode(), lag])
    Gxtheta = TransferFunction(np.array([1.0, 0.3]), poles, 1.0)
    slope = float(np.prod(1.0 - poles).real) / 0.7
    Gxtheta = replace(Gxtheta, gain=slope * rng.uniform(1e-3, 3e-3))
    x, y, theta = as_response(Gxx), as_response(Gyy), as_response(Gxtheta, 0.0)
    return Plant(x, y, theta, float(rng.uniform(120.0, 160.0)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_other_printers_are_recovered(tmp_path: Path, quick: Path, seed: int) -> None:
    check_recovered(Bench(tmp_path, random_plant(seed), quick, klipper=False), (90.0, 140.0, 190.0))
