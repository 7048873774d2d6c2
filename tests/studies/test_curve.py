"""Time against error: more error takes less time, as conversions with that bound do."""

from __future__ import annotations

from itertools import pairwise

import pytest

from hframe_post.conversion.options import Options
from hframe_post.library import convert, speed_curve
from hframe_post.page.speed_page import speed_page
from hframe_post.printer.settings import Printer
from hframe_post.studies.speed_curve import Curve, curve_as_json, curve_as_text, recommended
from tests.conftest import SAMPLES

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def lines() -> list[bytes]:
    """The first eight layers of a cube."""
    all_lines = (SAMPLES / "cube.gcode").read_bytes().splitlines(keepends=True)
    return all_lines[: all_lines.index(b";LAYER:8\n")]


@pytest.fixture(scope="module")
def found(lines: list[bytes], paper: Printer) -> Curve:
    return speed_curve(lines, paper)


def test_more_error_takes_less_time_and_higher_feed_rates_less_still(found: Curve) -> None:
    for feed in ("kept", "raised"):
        times = [getattr(step, feed).seconds for step in found.steps]
        assert all(b < 1.01 * a for a, b in pairwise(times))
    assert all(step.raised.seconds < 1.005 * step.kept.seconds for step in found.steps)
    last = found.steps[-1].raised
    assert last.seconds < 0.8 * found.original.seconds
    assert last.errors.ours["outer-wall"] < last.errors.shaped["outer-wall"]
    assert sum(last.limited_by.values()) == pytest.approx(last.seconds, rel=0.05)


def test_a_conversion_takes_that_time_within_that_error(
    found: Curve, lines: list[bytes], paper: Printer
) -> None:
    middle = found.steps[len(found.steps) // 2]
    for step in (found.steps[0], middle, recommended(found)):
        for point, speed_up in ((step.kept, 1.0), (step.raised, 20.0)):
            options = Options(max_error={"": step.bound}, speed_up=speed_up)
            speed = convert(lines, None, paper, options).speed
            assert speed is not None
            assert speed["print_time_s"]["after"] == pytest.approx(point.seconds, rel=0.03)
            worst = max(each["under_model_error_um"] for each in speed["features"].values())
            assert worst == pytest.approx(1e3 * point.worst, rel=0.1)


def test_the_report_names_what_binds(found: Curve, paper: Printer) -> None:
    text = curve_as_text(found)
    assert "--speed-up max' raises them" in text
    assert len(curve_as_json(found)["points"]) == len(found.steps)
    shown = speed_page(found, paper, "cube")
    assert b"as sliced, today" in shown
    assert b"minimum layer time" in shown
