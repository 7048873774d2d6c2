"""The cause of a nonlinearity, found from the harmonics of sweeps."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.diagnosis.nonlinearity import (
    AxisSweeps,
    LinearPrinter,
    Nonlinearity,
    find_nonlinearity,
    with_backlash,
)
from hframe_post.identification.recordings.alignment import acceleration, aligned
from hframe_post.identification.responses.frequency_response import harmonics
from hframe_post.model.impulse_response import Linear
from tests.conftest import few
from tests.random_printers import swept
from tests.simulator import Axis, Chip, Machine, Mode

LINEAR = Machine(Axis((Mode(32.0, 0.06),)), Axis((Mode(41.0, 0.08),)))

STEP = 0.0206  # mm of belt


def responds(G: Linear, hz: Array) -> Complex:
    return G.response(2.0 * np.pi * hz * TS)


def both(machine: Machine, chip: Chip, step: float = 0.0) -> Nonlinearity | None:
    axes: dict[str, AxisSweeps] = {}
    exact = LINEAR.exact()
    for run in swept(machine, chip, (140.0,), (140.0,), 1, step=step):
        u = acceleration(run.command[:, run.axis])
        found = harmonics(u, aligned(u, run.nozzle, run.axis).acceleration[:, run.axis])
        assert found is not None
        G = (exact.Gxx, exact.Gyy)[run.axis]
        printer = LinearPrinter(partial(responds, G), 1.0, machine.x.delay)
        axes["xy"[run.axis]] = AxisSweeps([(run.command[:, run.axis], found)], printer)
    return find_nonlinearity(axes, STEP)


@pytest.mark.parametrize("noise", few([20.0, 4.0], 1))
def test_a_linear_printer_has_no_nonlinearity(noise: float) -> None:
    assert both(LINEAR, Chip(noise=noise, gains=(1.04, 0.97, 1.0))) is None


@pytest.mark.slow
def test_motor_steps_neither_count_nor_hide_backlash() -> None:
    """Steps make harmonics of 1 to 2 % of the answer that correlate with no cause."""
    assert both(LINEAR, Chip(), STEP) is None
    loose = Machine(replace(LINEAR.x, play=0.02), replace(LINEAR.y, play=0.02))
    found = both(loose, Chip(), STEP)
    assert found is not None
    assert found.cause == "backlash"


CAUSES = [
    ({"friction": 300.0}, "friction", 300.0),
    ({"play": 0.01}, "backlash", 0.01),
    ({"second": 0.03}, "one-sided", None),
    ({"third": 0.05}, "hardening", None),
    ({"friction": 900.0}, "friction", 900.0),
    ({"play": 0.02}, "backlash", 0.02),
]


@pytest.mark.parametrize(
    ("changed", "cause", "size"),
    few(CAUSES, 4),
)
def test_cause_and_size_are_found(changed: dict[str, Any], cause: str, size: float | None) -> None:
    machine = Machine(replace(LINEAR.x, **changed), replace(LINEAR.y, **changed))
    found = both(machine, Chip())
    assert found is not None
    assert found.cause == cause
    assert 0.01 < found.share < 0.3
    if size is not None:
        assert found.size == pytest.approx(size, rel=0.15)


def test_backlash_agrees_with_its_recurrence() -> None:
    u = np.cumsum(np.random.default_rng(1).normal(size=1000))
    y, expected = u[0], []
    for at in u:
        y = min(max(y, at - 0.5), at + 0.5)
        expected.append(y)
    assert with_backlash(u, 1.0) == pytest.approx(np.array(expected))
