"""The picture of a print: bounded, and no error is lost in it."""

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import TS
from hframe_post.conversion import spans
from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import convert
from hframe_post.prediction import picture as picture_module
from hframe_post.prediction.picture import Picture
from hframe_post.prediction.predict import SHOWN_EVERY, Judge
from hframe_post.prediction.statistics import Labels
from hframe_post.prediction.windows import ALIKE, WINDOW, Windows
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Samples
from tests.gcode_tools import sample

STRATEGIES = ("fbs", "racking")  # errors without compensation are those of the file as sliced


def taken(paper: Printer) -> tuple[Picture, dict[str, float]]:
    lines = sample("rectangle.gcode")
    report = convert(lines, None, paper, Options("racking", STRATEGIES, picture=True))
    assert report.picture is not None
    return report.picture, {name: report.contour[name].all.peak for name in STRATEGIES}


def test_the_largest_error_of_each_strategy_is_in_it(paper: Printer) -> None:
    picture, peaks = taken(paper)
    found = dict(zip(picture.strategies, picture.pieces().error.max(axis=0), strict=True))
    assert found.pop("none") > max(peaks.values())
    assert found == pytest.approx(peaks, rel=1e-6)  # in single precision


def test_pieces_lie_on_the_path_at_lines_of_the_file(paper: Printer) -> None:
    pieces = taken(paper)[0].pieces()
    printed = pieces.layer == 1
    x, y = pieces.xy[printed].T
    on_side = np.isin(x.round(6), (140.0, 260.0)) | np.isin(y.round(6), (100.0, 120.0))
    assert on_side.mean() > 0.99
    assert set(pieces.line.tolist()) <= set(range(1, 20))
    assert np.hypot(np.diff(x), np.diff(y)).max() <= 2 * picture_module.FINEST


def test_the_nozzle_is_off_the_path_by_its_error(paper: Printer) -> None:
    """And the nearest place on the path, from which its way is magnified, is on the path."""
    picture, _ = taken(paper)
    pieces = picture.pieces()
    far = np.linalg.norm(pieces.off.astype(float), axis=2)
    assert (far <= pieces.error * (1.0 + np.finfo(np.float32).eps)).all()  # both are rounded
    assert far.max() > 0.5 * pieces.error.max()
    nearest = pieces.xy[:, None] + pieces.nozzle - pieces.off
    ends = pieces.xy[pieces.begins == 0]
    corner = 0.5 * 100.0 * TS * SHOWN_EVERY / np.sqrt(2.0)  # cut between two samples at 100 mm/s
    assert max(distance_to(place, ends) for place in nearest[::7].reshape(-1, 2)) < corner


def test_each_piece_has_the_speed_of_its_path(paper: Printer) -> None:
    """In the second window, too, which begins in motion."""
    n, judge, picture = (ALIKE + 1) * WINDOW, Judge(paper.plant), Picture(Labels())
    path = np.zeros((n, 4))
    path[:, 0] = 100.0 + 5.0 * TS * np.arange(n)
    whole = Samples(0, path, np.zeros(n, np.int64), (), {"none": path[:, :2]}, ends_stretch=True)
    windows = list(Windows(judge.before, judge.after).of([whole]))
    assert len(windows) == 2
    for window in windows:
        picture.add(judge.judged(window))
    assert picture.pieces().speed == pytest.approx(5.0)


def test_a_long_print_is_coarser(paper: Printer, monkeypatch: pytest.MonkeyPatch) -> None:
    fine = taken(paper)[0].pieces()
    monkeypatch.setattr(picture_module, "MOST", 40)
    picture, _ = taken(paper)
    coarse = picture.pieces()
    assert 2 <= picture.coarser <= picture_module.SHAPED
    assert 8 <= len(coarse.line) <= 40
    kinds = {*zip(fine.layer.tolist(), fine.feature.tolist(), strict=True)}
    for layer, feature in kinds:  # no error of one feature is shown as another's
        here, there = (
            each.error[(each.layer == layer) & (each.feature == feature)].max(axis=0)
            for each in (fine, coarse)
        )
        np.testing.assert_allclose(there, here)
    length, near = picture.finest
    for place in fine.xy[fine.begins == 0]:
        assert distance_to(place, coarse.xy) <= 2.0 * near
    assert np.hypot(*np.diff(coarse.xy, axis=0).T)[coarse.begins[1:] == 0].max() <= length


def distance_to(place: np.ndarray, path: np.ndarray) -> float:
    """How far it is from a polyline."""
    way = np.diff(path, axis=0)
    square = np.maximum((way**2).sum(axis=1), 1e-12)
    t = np.clip(((place - path[:-1]) * way).sum(axis=1) / square, 0.0, 1.0)
    return float(np.hypot(*(place - path[:-1] - t[:, None] * way).T).min())


def test_what_has_no_shape_is_bounded_too(paper: Printer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture_module, "MOST", 2)
    picture, peaks = taken(paper)
    pieces = picture.pieces()
    assert picture.coarser > picture_module.SHAPED
    assert len(pieces.line) <= 2
    found = dict(zip(picture.strategies, pieces.error.max(axis=0), strict=True))
    assert found.pop("none") > max(peaks.values())
    assert found == pytest.approx(peaks, rel=1e-6)  # in single precision


def test_spans_know_their_layers(paper: Printer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Marks without a number are counted from the beginning of the print, not of a span."""
    lines = ["G28", "M83", "G1 X100 Y100 Z0.2 F9000"]
    for _ in range(4):
        lines += [";LAYER_CHANGE", ";TYPE:Infill", "G1 X140 E2 F3000", "G1 E-1", "G1 E1"]
        lines += ["G1 X100 E2", "G1 Z0.3"]
    text = [line.encode() + b"\n" for line in lines]
    options = Options("racking", STRATEGIES, picture=True)
    whole = convert(text, None, paper, options).picture
    monkeypatch.setattr(spans, "SPAN_S", 0.5)
    parts = convert(text, None, paper, replace(options, jobs=2)).picture
    assert whole is not None
    assert parts is not None
    assert whole.labels.layers[1:] == ["0", "1", "2", "3"]
    assert parts.labels.layers[1:] == ["0", "1", "2", "3"]
    assert parts.labels.features == whole.labels.features
    printed = {key: sums[0] for key, sums in whole.sums.items()}
    assert {key: sums[0] for key, sums in parts.sums.items()} == pytest.approx(printed, rel=0.02)
