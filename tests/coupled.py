"""Printers whose modes are not quite along x and y, so that each command moves both."""

from dataclasses import replace

import numpy as np
from scipy import signal

from hframe_post.arrays import TS, X, Y
from hframe_post.model.plant import Coupling, Plant
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.printer.profile import load
from tests.plants import as_response

CENTRE = 140.0  # of the bed, mm


def mode(hz: float, damping: float) -> TransferFunction:
    """Return a resonance, exactly discretised for straight lines of 1 ms, and a sample late."""
    w = 2.0 * np.pi * hz
    num, den, _ = signal.cont2discrete(([w * w], [1.0, 2.0 * damping * w, w * w]), TS, "foh")
    zeros, poles = np.roots(num[0]).astype(complex), np.roots(den).astype(complex)
    G = TransferFunction(zeros, np.append(poles, 0.0), float(num[0][0]))
    return replace(G, gain=G.gain / G.dc_gain)


def mixed(a: float, one: TransferFunction, b: float, other: TransferFunction) -> TransferFunction:
    """Return a·one + b·other, of the same delay; exactly 0 at rest if a = −b."""
    parts = (a * one.gain, one.zeros, other.poles), (b * other.gain, other.zeros, one.poles)
    one_num, other_num = (g * np.poly(np.append(zeros, poles[:2])) for g, zeros, poles in parts)
    num = one_num + other_num
    poles = np.concatenate([one.poles[:2], other.poles])
    num = np.trim_zeros(np.where(np.abs(num) < 1e-12 * np.abs(num).max(), 0.0, num), "f")
    zeros = np.roots(num).astype(complex)
    if a == -b:
        zeros[np.abs(zeros - 1.0).argmin()] = 1.0
        return TransferFunction(zeros, poles, float(num[0].real))
    G = TransferFunction(zeros, poles, float(num[0].real))
    return replace(G, gain=G.gain * (a + b) / G.dc_gain)


def coupled_plant(seed: int, least: float = 0.05, most: float = 0.3, racks: bool = False) -> Plant:
    """Return a random plant whose modes are turned, at the bed's edges more or less than in its
    middle, where cross terms are ``least`` to ``most`` of the direct ones at the modes.
    """
    rng = np.random.default_rng(seed)
    x, y = (mode(float(rng.uniform(25.0, 60.0)), float(rng.uniform(0.04, 0.12))) for _ in "xy")
    share = float(rng.uniform(least, most)) * float(rng.choice([-1.0, 1.0]))
    turned, along = np.arctan(share), int(rng.integers(2))
    c, s = float(np.cos(turned)), float(np.sin(turned))
    across = mixed(s * c, x, -s * c, y)
    varying = replace(across, gain=across.gain * float(rng.uniform(-0.5, 0.5)) / CENTRE)
    cross = [
        one
        for answer, command in ((Y, X), (X, Y))
        for one in (
            Coupling(answer, command, as_response(across, 0.0)),
            Coupling(answer, command, as_response(varying, 0.0), along, CENTRE),
        )
    ]
    Gxx, Gyy = mixed(c * c, x, s * s, y), mixed(s * s, x, c * c, y)
    Gxtheta = load("paper").plant.Gxtheta if racks else None
    return Plant(as_response(Gxx), as_response(Gyy), Gxtheta, CENTRE, tuple(cross))
