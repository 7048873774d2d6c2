"""The view of the layers: bounded, and no error is lost in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.conversion.pipeline import Options
from hframe_post.printer.settings import Printer
from hframe_post.studies import layer_view
from hframe_post.studies.layer_view import LayerView
from hframe_post.studies.simulation import Study, simulate
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


def test_a_long_print_is_joined_and_keeps_its_largest_errors(
    paper: Printer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(layer_view, "MOST", 60)
    view, peaks = viewed(paper)
    layers = view.layers().values()
    assert view.joined >= 2
    assert sum(len(each.line) for each in layers) <= 60
    errors = np.concatenate([each.error for each in layers])
    np.testing.assert_allclose(errors.max(axis=0), list(peaks.values()))
