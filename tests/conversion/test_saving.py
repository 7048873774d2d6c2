"""The time that a print could lose: by layers, and as a conversion with that bound shows it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import parsed
from hframe_post.conversion.saving import FasterTime
from hframe_post.firmware.registry import firmware
from hframe_post.library import convert
from hframe_post.planner.sliced import SlicedTime
from hframe_post.printer.settings import Printer
from tests.conftest import SAMPLES

CUBE = SAMPLES / "cube.gcode"


def lost(printer: Printer, layers: int, end: bytes = b"") -> float:
    """Return what a cube could lose by its first layers. end: of the file."""
    lines = CUBE.read_bytes().splitlines(keepends=True)
    lines = [*lines[: lines.index(b";LAYER:%d\n" % layers)], end]
    sliced = SlicedTime(firmware(printer).limits(printer))
    time = FasterTime(printer, sliced)
    for _ in time.items(sliced.items(parsed(lines, printer, Options()))):
        pass
    return time.lost()


def test_layers_keep_the_time_that_they_need_to_cool(paper: Printer) -> None:
    slow = replace(paper, limits=replace(paper.limits, min_layer_time=30.0))
    assert lost(slow, 24) == 0.0 < lost(paper, 24)
    assert lost(paper, 24, b"; slow_down_layer_time = 30\n") == 0.0


def test_a_few_layers_show_nothing(paper: Printer) -> None:
    assert lost(paper, 8) == 0.0


def test_slow_motors_gain_less(paper: Printer) -> None:
    gentle = replace(paper, speed=replace(paper.speed, acceleration=1500.0))
    assert lost(gentle, 24) < 0.8 * lost(paper, 24)


@pytest.mark.slow
def test_a_conversion_within_the_error_loses_that_time(paper: Printer) -> None:
    saving = convert(CUBE, None, paper).saving
    assert saving is not None
    speed = convert(CUBE, None, paper, Options(max_error={"": saving.error})).speed
    assert speed is not None
    seconds = speed["print_time_s"]
    found = seconds["before"] - seconds["after"]
    assert saving.seconds == pytest.approx(found, abs=0.03 * seconds["after"])
