"""The view of the layers: bounded, and no error is lost in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.conversion.pipeline import Options
from hframe_post.printer.settings import Printer
from hframe_post.studies.simulation import layer_view
from hframe_post.studies.simulation.layer_view import LayerView
from hframe_post.studies.simulation.simulate import Study, simulate
from tests.conftest import SAMPLES

STRATEGIES = ("none", "racking")


def viewed(paper: Printer) -> tuple[LayerView, dict[str, float]]:
    view = LayerView(STRATEGIES)
    lines = (SAMPLES / "rectangle.gcode").read_bytes().splitlines(keepends=True)
    options = replace(Options("racking"), predict=STRATEGIES)
    report = simulate(lines, paper, options, Study(paper.plant), view)
    return view, {name: report.parts.whole[name].contour.all.peak for name in STRATEGIES}


def test_the_largest_error_of_each_strategy_is_in_it(paper: Printer) -> None:
    view, peaks = viewed(paper)
    errors = np.concatenate([each.error for each in view.layers().values()])
    np.testing.assert_allclose(errors.max(axis=0), list(peaks.values()))


def test_segments_lie_on_the_path_at_lines_of_the_file(paper: Printer) -> None:
    (layer,) = [each for n, each in viewed(paper)[0].layers().items() if n == 1]
    x, y = layer.xy.T
    on_side = np.isin(x.round(6), (140.0, 260.0)) | np.isin(y.round(6), (100.0, 120.0))
    assert on_side.mean() > 0.99
    assert set(layer.line.tolist()) <= set(range(1, 20))
    assert np.hypot(*np.diff(layer.xy, axis=0).T).max() <= 2 * layer_view.FINEST


def test_a_long_print_is_shown_coarser_and_keeps_shape_and_largest_errors(
    paper: Printer, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, _ = viewed(paper)
    monkeypatch.setattr(layer_view, "MOST", 60)
    view, peaks = viewed(paper)
    layers = view.layers().values()
    assert 2 <= view.coarser <= layer_view.SHAPED
    assert 8 <= sum(len(each.line) for each in layers) <= 60
    errors = np.concatenate([each.error for each in layers])
    np.testing.assert_allclose(errors.max(axis=0), list(peaks.values()))
    for number, fine in whole.layers().items():
        coarse = view.layers()[number]
        for feature in np.unique(fine.feature):  # no error of one feature is printed of another
            fine_errors, its = (each.error[each.feature == feature] for each in (fine, coarse))
            np.testing.assert_allclose(its.max(axis=0), fine_errors.max(axis=0))
        length, near = view.finest
        for place in fine.xy[fine.begins == 0]:
            assert beside(place, coarse.xy) <= 2.0 * near
        assert np.hypot(*np.diff(coarse.xy, axis=0).T)[coarse.begins[1:] == 0].max() <= length


def beside(place: np.ndarray, path: np.ndarray) -> float:
    """How far it is from a polyline."""
    way = np.diff(path, axis=0)
    square = np.maximum((way**2).sum(axis=1), 1e-12)
    t = np.clip(((place - path[:-1]) * way).sum(axis=1) / square, 0.0, 1.0)
    return float(np.hypot(*(place - path[:-1] - t[:, None] * way).T).min())


def test_what_has_no_shape_is_bounded_too(paper: Printer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layer_view, "MOST", 3)
    view, peaks = viewed(paper)
    layers = view.layers().values()
    assert view.coarser > layer_view.SHAPED
    assert sum(len(each.line) for each in layers) <= 3
    errors = np.concatenate([each.error for each in layers])
    np.testing.assert_allclose(errors.max(axis=0), list(peaks.values()))
