"""A share of a print stands for all of it."""

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.firmware.registry import firmware
from hframe_post.prediction.error_meter import ErrorMeter
from hframe_post.prediction.predict import as_written
from hframe_post.prediction.windows import FEW, SOME, WINDOW, Windows
from hframe_post.printer.settings import Printer
from hframe_post.stream.chunks import smaller
from hframe_post.stream.types import Samples
from tests.paths import walk

WHOLE = 8 * WINDOW


def moving(n: int) -> Samples:
    """Return walks, one after the other, that are commanded as they stand."""
    rng = np.random.default_rng(3)
    walks = [np.diff(walk(rng, 129), axis=0) for _ in range(0, n, 128)]
    path = np.cumsum(np.concatenate(walks), axis=0)[:n]
    xyze = np.column_stack([path + 100.0, np.zeros(n), 0.01 * np.arange(n)])
    commands = {"none": xyze[:, :2]}
    return Samples(0, xyze, np.zeros(n, np.int64), commands=commands, ends_stretch=True)


@pytest.mark.parametrize("n", [WINDOW // 2, 63 * WINDOW + 100])
def test_errors_of_windows_are_those_of_the_whole_print(paper: Printer, n: int) -> None:
    """What is judged has the same errors as in the whole print, wherever that is cut."""
    whole = moving(n)
    found = []
    for chunks in ([whole], smaller([whole], 777), smaller([whole], 5000)):
        meter = ErrorMeter(paper.plant, whole=WHOLE)
        assert sum(map(len, meter.samples(chunks))) == n
        found.append((meter.judged, meter.contour["none"].micrometres()))
    assert found[0] == found[1] == found[2]
    expected = ErrorMeter(paper.plant)
    for _ in expected.samples([whole]):
        pass
    judged, errors = found[0]
    one, other = (each.contour["none"] for each in (expected, meter))
    assert judged == min(n, WHOLE + 4 * WINDOW)
    assert other.all.count == pytest.approx(one.all.count, rel=0.1)
    assert errors["rms"] == pytest.approx(one.micrometres()["rms"], rel=0.05)
    if judged == n:
        assert errors == one.micrometres()


def test_errors_are_those_of_the_motion_that_lines_make(paper: Printer) -> None:
    """Decimated lines leave an error of their own, wherever the print is cut, in windows alike."""
    whole = moving(2 * WINDOW)
    whole = replace(whole, commands={"racking": whole.xyze[:, :2]})
    rules, found = firmware(paper).motion(0.1), []
    for chunks in ([whole], smaller([whole], 777), smaller([whole], 1000)):
        meter = ErrorMeter(paper.plant, rules=rules)
        passed = [chunk.commands["racking"] for chunk in meter.samples(chunks)]
        assert (np.concatenate(passed) == whole.commands["racking"]).all()
        found.append(meter.contour["racking"].micrometres())
    assert found[0] == found[1] == found[2]
    off = as_written(whole, rules).commands["racking"] - whole.commands["racking"]
    assert 0.0 < np.linalg.norm(off, axis=1).max() < 0.1  # mm
    windows = ErrorMeter(paper.plant, whole=WHOLE, rules=rules)
    for _ in windows.samples([whole]):
        pass
    assert windows.contour["racking"].rms == pytest.approx(1e-3 * found[0]["rms"], rel=0.02)


def test_a_window_is_one_of_so_many() -> None:
    chunks = smaller([moving(64 * WINDOW)], 3000)
    windows = [each for _, found in Windows(1000, 60, WHOLE).samples(chunks) for each in found]
    starts = [each.piece.first + each.start for each in windows]
    assert [start // WINDOW for start in starts] == [*range(8), 12, 20, 28, 48]
    assert [each.weight for each in windows] == [1] * 8 + [SOME] * 3 + [FEW]
    assert {each.stop - each.start for each in windows} == {WINDOW}
