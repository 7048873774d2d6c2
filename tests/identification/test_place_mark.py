"""The place of a run is recognised from its recording, so exchanged files are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings import place_mark
from hframe_post.identification.recordings.alignment import acceleration
from hframe_post.identification.recordings.sweep import runs as planned
from hframe_post.identification.responses.measured import Run, Settings, nozzle_responses
from tests.random_printers import BAND, printer, swept
from tests.simulator import Axis, Chip, Machine, Mode

PLACES = (80.0, 110.0, 140.0, 170.0, 200.0)
LAGGING = Machine(Axis((Mode(14.0, 0.3),), delay=0.003), Axis((Mode(38.0, 0.08),)), racking=2e-8)


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return swept(LAGGING, Chip(drift=0.004), PLACES, (), 3, 8.0)


def test_recordings_in_order_are_accepted(runs: list[Run]) -> None:
    assert len(nozzle_responses(runs, Settings(BAND)).runs) == len(PLACES)


@pytest.mark.parametrize("order", [(4, 3, 2, 1, 0), (1, 0, 2, 3, 4), (0, 1, 2, 4, 3)])
def test_exchanged_recordings_are_refused(runs: list[Run], order: tuple[int, ...]) -> None:
    wrong = [replace(run, nozzle=runs[k].nozzle) for run, k in zip(runs, order, strict=True)]
    with pytest.raises(IdentificationError, match="files of two places are exchanged"):
        nozzle_responses(wrong, Settings(BAND))


def test_a_plant_that_answers_twice_is_accepted() -> None:
    """The answers of two modes are 15 ms apart, and either may be the larger one."""
    names, places, answers = ["left", "right"], [80.0, 140.0], []
    for place, share in zip(places, (0.24, 0.26), strict=True):
        modes = Mode(30.0, 0.11, 1.0 - share), Mode(80.0, 0.09, share)
        machine = Machine(Axis(modes, 0.0017), Axis(modes))
        (run,) = planned(printer(machine, 8.0), 0, [(place, 147.5)])
        motion = machine.played(run.command)[:, 2]
        answers.append(place_mark.answer(acceleration(run.command[:, 0]), motion))
    left, right = answers
    assert left is not None
    assert right is not None
    assert abs(left.lag - right.lag) > place_mark.TOLERANCE
    place_mark.check(names, places, answers)
    with pytest.raises(IdentificationError, match="exchanged"):
        place_mark.check(names, places[::-1], [shifted(left, 120), shifted(right, -120)])


def shifted(answer: place_mark.Answer, samples: int) -> place_mark.Answer:
    """Return the same answer, later."""
    cycles = np.arange(len(answer.phase)) / (2 * len(answer.phase) - 2)
    phase = answer.phase * np.exp(-2j * np.pi * samples * cycles)
    return place_mark.Answer(answer.lag + samples, phase)
