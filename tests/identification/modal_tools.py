"""A machine with two modes along x, and its frequency response."""

import numpy as np

from hframe_post.arrays import TS, Array, Complex
from tests.simulator import Axis, Machine, Mode

HZ = np.arange(3.0, 100.01, 0.25)
TWO = Machine(
    Axis((Mode(30.0, 0.05, 0.8), Mode(70.0, 0.04, 0.2)), delay=0.0013),
    Axis((Mode(38.0, 0.1),)),
    racking=2e-8,
)


def continuous(axis: Axis, hz: Array) -> Complex:
    s = 2j * np.pi * hz
    G = axis.response()
    played = np.polyval(G.num, s) / np.polyval(G.den, s)
    return np.asarray(played * np.exp(-s * axis.delay) * np.sinc(hz * TS) ** 2)
