"""A recording tells by itself at which place it was made."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hframe_post.errors import IdentificationError
from hframe_post.identification.heard import Run, Settings, by_nozzle
from tests.simulator import Axis, Chip, Machine, Mode
from tests.strangers import BAND, swept

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
