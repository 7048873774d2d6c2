"""What a print has today: its pieces stand for the whole, also where it never stops."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.conversion import sliced_errors
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import parsed
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.prediction.statistics import ContourErrors
from hframe_post.printer.settings import Printer
from tests.conftest import SAMPLES


def vase(layers: int) -> list[bytes]:
    """A polygon of 40 sides in one stroke, without a stop."""
    angle = np.linspace(0.0, 2.0 * np.pi * layers, 40 * layers + 1)[1:]
    lines = [b"G28\n", b"M83\n", b"G1 X160 Y140 Z0.2 F6000\n", b"M204 S3000\n"]
    for k, (x, y) in enumerate(
        zip(130 + 30 * np.cos(angle), 140 + 30 * np.sin(angle), strict=True)
    ):
        lines.append(
            b"G1 X%.3f Y%.3f Z%.4f E0.2 F%d\n" % (x, y, 0.2 + 0.005 * k, 2400 + 60 * (k % 97))
        )
    return lines


def errors(printer: Printer) -> dict[str, ContourErrors]:
    return (
        SlicedFile.from_items(parsed(vase(60), printer, Options("none")), printer).today().contour
    )


def test_a_share_of_a_print_without_stops_stands_for_all(
    paper: Printer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sliced_errors, "LEAST_S", 1e9)
    whole = errors(paper)
    monkeypatch.setattr(sliced_errors, "LEAST_S", 30.0)
    share = errors(paper)
    for name in ("none", "shaper"):
        assert share[name].all.count < 0.4 * whole[name].all.count
        assert share[name].rms == pytest.approx(whole[name].rms, rel=0.1), name


def test_a_move_of_days_takes_no_memory(paper: Printer) -> None:
    lines = [
        b"G28\n",
        b"M83\n",
        b"G1 X10 Y10 Z0.2 F6000\n",
        b"G1 X270 E1 F12\n",
        b"G1 X10 E1 F600\n",
    ]
    found = SlicedFile.from_items(parsed(lines * 3, paper, Options("none")), paper)
    assert sum(len(path) for path, _ in found.paths) < 200_000, "samples"


def test_the_cube_which_hardly_stops_is_judged_all_over(paper: Printer) -> None:
    """Its first layer is slow; with all of it the error is 90 µm."""
    with (SAMPLES / "cube.gcode").open("rb") as cube:
        found = SlicedFile.from_items(parsed(cube, paper, Options("none")), paper).today()
    whole = 1e3 * found.contour["none"].rms
    assert whole == pytest.approx(90.0, rel=0.1)
