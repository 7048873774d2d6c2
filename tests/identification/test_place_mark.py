"""A recording tells by itself at which place it was made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings import place_mark
from hframe_post.identification.recordings.alignment import acceleration
from hframe_post.identification.recordings.sweep import runs as planned
from hframe_post.identification.responses.measured import Run, Settings, by_nozzle
from tests.simulator import Axis, Chip, Machine, Mode
from tests.strangers import BAND, printer, swept

PLACES = (80.0, 110.0, 140.0, 170.0, 200.0)
LAGGING = Machine(Axis((Mode(14.0, 0.3),), delay=0.003), Axis((Mode(38.0, 0.08),)), racking=2e-8)


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return swept(LAGGING, Chip(drift=0.004), PLACES, (), 3, 8.0)


def test_each_at_its_own_place_is_well(runs: list[Run]) -> None:
    assert len(by_nozzle(runs, Settings(BAND)).runs) == len(PLACES)


@pytest.mark.parametrize("order", [(4, 3, 2, 1, 0), (1, 0, 2, 3, 4), (0, 1, 2, 4, 3)])
def test_another_order_is_told(runs: list[Run], order: tuple[int, ...]) -> None:
    wrong = [replace(run, nozzle=runs[k].nozzle) for run, k in zip(runs, order, strict=True)]
    with pytest.raises(IdentificationError, match="files of two places exchanged"):
        by_nozzle(wrong, Settings(BAND))


def test_a_plant_that_answers_twice_is_at_its_own_place() -> None:
    """Either mode's answer may be the louder one, 15 ms apart: that is no other place."""
    names, places, answers = ["left", "right"], [80.0, 140.0], []
    for place, share in zip(places, (0.24, 0.26), strict=True):
        modes = Mode(30.0, 0.11, 1.0 - share), Mode(80.0, 0.09, share)
        machine = Machine(Axis(modes, 0.0017), Axis(modes))
        (run,) = planned(printer(machine, 8.0), 0, [(place, 147.5)])
        felt = machine.played(run.command)[:, 2]
        answers.append(place_mark.answer(acceleration(run.command[:, 0]), felt))
    left, right = answers
    assert left is not None
    assert right is not None
    assert abs(left.lag - right.lag) > place_mark.APART * place_mark.REST
    place_mark.check(names, places, answers)
    with pytest.raises(IdentificationError, match="exchanged"):
        place_mark.check(names, places[::-1], [shifted(left, 120), shifted(right, -120)])


def shifted(answer: place_mark.Answer, samples: int) -> place_mark.Answer:
    """The same, so much later."""
    cycles = np.arange(len(answer.phase)) / (2 * len(answer.phase) - 2)
    phase = answer.phase * np.exp(-2j * np.pi * samples * cycles)
    return place_mark.Answer(answer.lag + samples, phase)
