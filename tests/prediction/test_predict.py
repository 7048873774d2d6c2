"""Prediction: the exact plant, the distance to the path, and a share that stands for all."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.arrays import Array, Integers
from hframe_post.firmware.registry import firmware
from hframe_post.native.stop import NEAREST
from hframe_post.prediction.error_meter import ErrorMeter
from hframe_post.prediction.predict import Played, contour_error
from hframe_post.prediction.statistics import SMALLEST, ErrorStatistics
from hframe_post.prediction.windows import FEW, SOME, WINDOW, Windows
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Samples
from hframe_post.writers.gcode import GcodeWriter, as_written
from tests.paths import smaller, strokes, walk


def brute_force(path: Array, actual: Array, at: Integers, reach: int) -> Array:
    """Distance of each point to the polyline through the samples within ``reach``."""
    distances = []
    for point, k in zip(actual, at, strict=True):
        low, high = max(k - reach, 0), min(k + reach, len(path) - 1)
        start, along = path[low:high], np.diff(path[low : high + 1], axis=0)
        length2 = np.maximum((along**2).sum(axis=1), 1e-30)
        share = np.clip(((point - start) * along).sum(axis=1) / length2, 0, 1)
        distances.append(np.hypot(*(point - start - share[:, None] * along).T).min())
    return np.array(distances)


def broken_line(seed: int) -> Array:
    """Straight strokes with sharp corners, a curve and a rest, 1 ms apart."""
    rng = np.random.default_rng(seed)
    turns = np.repeat(rng.uniform(-np.pi, np.pi, 12), 60)
    turns[200:330] += np.linspace(0, 4, 130)
    speed = 0.06 * np.abs(np.sin(np.arange(720) * np.pi / 60)) + 0.004
    speed[400:430] = 0.0
    return 100 + np.cumsum(np.column_stack([np.cos(turns), np.sin(turns)]) * speed[:, None], axis=0)


@pytest.mark.parametrize("every", [1, 2, 3])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_contour_error_is_the_distance_to_the_path(seed: int, every: int) -> None:
    path = broken_line(seed)
    rng = np.random.default_rng(seed)
    at = np.arange(30, len(path) - 30, every)
    wobble = np.cumsum(rng.normal(size=(len(path), 2)), axis=0) * 2e-4
    got, actual = contour_error(path, path + wobble, at), (path + wobble)[at]
    widest = brute_force(path, actual, at, NEAREST + 2)
    assert (got >= widest - 1e-12).all()
    assert (got <= np.hypot(*(actual - path[at]).T) + 1e-12).all()
    assert np.sqrt((got**2).mean()) <= 1.02 * np.sqrt((widest**2).mean())


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
    own, found = firmware(paper), []
    rules = own.motion(0.1)
    for cut, share in ((len(whole), None), (777, None), (1000, None), (1000, WHOLE)):
        played, passed = Played("racking"), list[Samples]()
        meter = ErrorMeter(paper.plant, whole=share, played=[played])
        writer = GcodeWriter("racking", rules, own.code(), played=played)
        for _ in writer.write(kept(meter.samples(smaller([whole], cut)), passed)):
            pass
        meter.end()
        commands = np.concatenate([chunk.commands["racking"] for chunk in passed])
        assert (commands == whole.commands["racking"]).all()
        found.append(meter.contour["racking"].micrometres())
    assert found[0] == found[1] == found[2] == found[3]
    (decimated,) = as_written([whole], ["racking"], rules, own.code())
    expected = ErrorMeter(paper.plant)
    for _ in expected.samples([decimated]):
        pass
    assert found[0] == expected.contour["racking"].micrometres()


def test_lines_are_as_near_to_the_command_as_they_may(paper: Printer) -> None:
    own, path = firmware(paper), strokes()
    xyze = np.column_stack([path, np.zeros((len(path), 2))])
    whole = Samples(0, xyze, np.zeros(len(path), np.int64), (), {"racking": path})
    (made,) = as_written([whole], ["racking"], own.motion(0.1), own.code())
    off = made.commands["racking"] - path
    assert 0.0 < np.linalg.norm(off, axis=1).max() < 0.1  # mm


def kept(chunks: Iterable[Samples], passed: list[Samples]) -> Iterator[Samples]:
    for chunk in chunks:
        passed.append(chunk)
        yield chunk


def test_a_window_is_one_of_so_many() -> None:
    chunks = smaller([moving(64 * WINDOW)], 3000)
    windows = list(Windows(1000, 60, WHOLE).of(chunks))
    starts = [each.piece.first + each.start for each in windows]
    assert [start // WINDOW for start in starts] == [0, 12, 20, 28, 48]
    assert [each.weight for each in windows] == [1] + [SOME] * 3 + [FEW]
    assert [each.stop - each.start for each in windows] == [8 * WINDOW] + [WINDOW] * 4


def test_what_has_an_example_is_shown_all_the_same() -> None:
    """Windows of a picture follow each other, wherever the stream is cut, and count as before."""
    whole = moving(40 * WINDOW + 5)
    found = []
    for chunks in ([whole], smaller([whole], 777), smaller([whole], 9000)):
        windows = list(Windows(1000, 60, WHOLE, shown=True).of(chunks))
        starts = [each.piece.first + each.start for each in windows]
        stops = [each.piece.first + each.stop for each in windows]
        assert [*starts, len(whole)] == [0, *stops]
        found.append([*zip(starts, (each.weight for each in windows), strict=True)])
    assert found[0] == found[1] == found[2]
    assert [start // WINDOW for start, weight in found[0] if weight] == [0, 12, 20, 28]


ERRORS = st.lists(st.floats(0.0, 250.0), min_size=1, max_size=60).map(np.array)
BIN = 1.0 + 1.0 / 128.0


def statistics(errors: Array) -> ErrorStatistics:
    running = ErrorStatistics()
    running.add(errors)
    return running


@given(ERRORS)
def test_rms_and_peak_are_exact(errors: Array) -> None:
    running = statistics(errors)
    assert running.count == len(errors)
    assert running.rms == pytest.approx(np.sqrt(np.square(errors).mean()), rel=1e-12)
    assert running.peak == errors.max()


@given(ERRORS, st.floats(0.01, 1.0))
def test_percentiles_are_within_their_bin(errors: Array, share: float) -> None:
    """Never below the true one, at most a bin above, and never below the smallest."""
    true = np.quantile(errors, share, method="inverted_cdf")
    got = statistics(errors).percentile(share)
    rounding = 1.0 + 1e-9
    assert got <= max(true, SMALLEST) * BIN * rounding
    assert got * rounding >= true
    assert got <= errors.max()
