"""Harmonics of the sweep, and the cause that they tell."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from hframe_post.identification.alignment import acceleration, aligned
from hframe_post.identification.linearity import Harmonics, Nonlinearity, harmonics, nonlinearity
from hframe_post.model.transfer_function import TransferFunction
from tests.simulator import Axis, Chip, Machine, Mode
from tests.strangers import swept

LINEAR = Machine(Axis((Mode(32.0, 0.06),)), Axis((Mode(41.0, 0.08),)))

STEP = 0.0206  # mm of belt


def both(machine: Machine, chip: Chip, step: float = 0.0) -> Nonlinearity | None:
    axes: dict[str, tuple[list[Harmonics], TransferFunction, float]] = {}
    exact = LINEAR.exact()
    for run in swept(machine, chip, (140.0,), (140.0,), 1, step=step):
        u = acceleration(run.command[:, run.axis])
        assert run.nozzle is not None
        found = harmonics(u, aligned(u, run.nozzle, run.axis).acceleration[:, run.axis])
        assert found is not None
        axes["xy"[run.axis]] = ([found], (exact.Gxx, exact.Gyy)[run.axis], machine.x.delay)
    return nonlinearity(axes, STEP)


@pytest.mark.parametrize("noise", [4.0, 20.0])
def test_a_linear_printer_has_none(noise: float) -> None:
    assert both(LINEAR, Chip(noise=noise, gains=(1.04, 0.97, 1.0))) is None


def test_whole_motor_steps_are_none_and_hide_none() -> None:
    """They make harmonics, of 1 to 2 % of the answer, that go along with no cause."""
    assert both(LINEAR, Chip(), STEP) is None
    loose = Machine(replace(LINEAR.x, play=0.02), replace(LINEAR.y, play=0.02))
    found = both(loose, Chip(), STEP)
    assert found is not None
    assert found.cause == "backlash"


@pytest.mark.parametrize(
    ("changed", "cause"),
    [
        ({"friction": 300.0}, "friction"),
        ({"friction": 900.0}, "friction"),
        ({"play": 0.01}, "backlash"),
        ({"second": 0.03}, "one-sided"),
        ({"third": 0.05}, "hardening"),
    ],
)
def test_the_cause_is_told(changed: dict[str, Any], cause: str) -> None:
    machine = Machine(replace(LINEAR.x, **changed), replace(LINEAR.y, **changed))
    found = both(machine, Chip())
    assert found is not None
    assert found.cause == cause
    assert 0.01 < found.share < 0.3
