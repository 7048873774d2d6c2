"""Drawn printers with friction, play and hardening belts show what real ones do.

A linear response to a sweep does not foresee strokes, and one to strokes compensates the rectangle
better. The estimator here is the tests' own, so that these are properties of the printers.
"""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.arrays import TS
from tests.friction_printers import Body, Friction, SlidingAxis, drawn_sliding, played
from tests.identification.nonlinear_printers import errors, shares
from tests.quantities import below, near

BODIES = (Body(42.0, 0.08), Body(70.0, 0.04, 0.3))
SLIDING = [seed for seed in range(12) if drawn_sliding(seed)[1] in ("friction", "mixed")]


def test_without_friction_the_axis_is_its_response() -> None:
    axis = SlidingAxis(BODIES, delay=1e-3)
    n = 4096
    command = np.zeros(n)
    command[1] = 1.0
    nozzle = np.append(0.0, played(axis, command)[:, 0])
    hz = np.asarray(np.fft.rfftfreq(n, TS), dtype=np.float64)
    seen, between = (hz > 2.0) & (hz < 100.0), np.sinc(hz * TS) ** 2
    found = (np.fft.rfft(nozzle) / np.fft.rfft(command))[seen]
    exact = (axis.response(hz) * between)[seen]
    off = np.abs(found - exact).max() / np.abs(exact).max()
    below(off, 0.02, "relative error of the response, 2 to 100 Hz")


@pytest.mark.parametrize(("creep", "held"), [(0.0, 0.0184), (5.0, 0.0)])
def test_friction_holds_the_nozzle_until_it_creeps(creep: float, held: float) -> None:
    """After a gentle stop it is about F/ω² short, unless its bristles creep."""
    f = Friction(2000.0, 0.005, creep)
    axis = SlidingAxis((Body(42.0, 0.08, 1.0, f), Body(70.0, 0.04, 0.3)))
    t = np.arange(0.0, 2.0, TS)
    command = 5.0 * (1.0 - np.cos(np.pi * np.clip(t, 0.0, 1.0)))
    short = command[-1] - played(axis, command)[-1, 0]
    near(short, held, 0.003, "way to the target after a stop, mm")


def test_a_response_to_a_sweep_does_not_foresee_strokes() -> None:
    found = shares(drawn_sliding(4)[0].x)
    near(found.rigid, 0.7, 0.15, "share of the strokes that a rigid axis leaves")
    below(
        0.8 * found.rigid, found.swept, "0.8 of it, which a response to the sweep leaves at least"
    )
    below(found.struck, 0.5 * found.swept, "share that a response to other strokes leaves")
    below(found.loud, 0.5, "share of the response to strokes that the sweep shows")


@pytest.mark.slow
def test_sliding_axes_are_like_the_real_one() -> None:
    """Of its strokes a rigid axis leaves 57 to 61 %, a sweep 55 to 58, other strokes 37 to 41."""
    axes = [
        axis for seed in SLIDING for axis in (drawn_sliding(seed)[0].x, drawn_sliding(seed)[0].y)
    ]
    found = [shares(axis) for axis in axes]
    rigid, swept, struck, loud = (
        float(np.median(values))
        for values in zip(
            *((one.rigid, one.swept, one.struck, one.loud) for one in found), strict=True
        )
    )
    near(rigid, 0.7, 0.1, "median share that a rigid axis leaves")
    near(swept / rigid, 0.87, 0.12, "median share that a sweep leaves, relative to it")
    near(struck / rigid, 0.4, 0.2, "median share that other strokes leave, relative to it")
    near(loud, 0.3, 0.15, "median share of the response to strokes that a sweep shows")


@pytest.mark.slow
def test_strokes_give_a_better_model_of_a_sliding_printer() -> None:
    """A sweep with a known start is nearly as good as strokes where a print is slower than these.

    So the cube, at 60 mm/s, is compared with TEST_RESONANCES of before December 2024 only. That
    of today moves the axes slowly as well, which keeps them sliding, and is like a sweep.
    """
    motions = ("strokes", "sweep", "pulses")
    found = [errors(drawn_sliding(seed)[0], motions, seed, shapers=False) for seed in (4, 8, 11)]

    def ratio(path: str, other: str) -> float:
        return float(np.median([one[path]["strokes"] / one[path][other] for one in found]))

    for path in ("rectangle", "rectangle 3000"):
        below(ratio(path, "sweep"), 0.9, f"error of the {path}, strokes / sweep")
        below(ratio(path, "pulses"), 0.4, f"error of the {path}, strokes / pulses")
    below(ratio("rectangle", "none"), 0.4, "error of the rectangle, strokes / none")
    below(ratio("cube", "none"), 0.8, "error of the cube, strokes / none")
    below(ratio("cube", "pulses"), 0.8, "error of the cube, strokes / pulses")
