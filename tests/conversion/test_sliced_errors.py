"""What a print has today: its pieces stand for the whole, also where it never stops."""

import math
from collections.abc import Iterable

import numpy as np
import pytest

from hframe_post.conversion import sliced_errors
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain
from hframe_post.conversion.sliced_errors import SlicedFile, Today
from hframe_post.printer.settings import Printer


def vase(layers: int) -> list[bytes]:
    """A polygon of 40 sides in one stroke, without a stop."""
    angle = np.linspace(0.0, 2.0 * np.pi * layers, 40 * layers + 1)[1:]
    lines = [b"G28\n", b"M83\n", b"G1 X160 Y140 Z0.2 F6000\n", b"M204 S3000\n"]
    for k, turned in enumerate(angle.tolist()):
        place = 130 + 30 * math.cos(turned), 140 + 30 * math.sin(turned), 0.2 + 0.005 * k
        lines.append(b"G1 X%.3f Y%.3f Z%.4f E0.2 F%d\n" % (*place, 2400 + 60 * (k % 97)))
    return lines


def today(lines: Iterable[bytes], printer: Printer) -> Today:
    return SlicedFile.from_items(Chain(printer, Options("none")).read(lines), printer).today()


def test_a_share_stands_for_a_vase(paper: Printer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sliced_errors, "KEPT_S", 1e9)
    all_of_it = today(vase(60), paper)
    monkeypatch.setattr(sliced_errors, "KEPT_S", 30.0)
    some = today(vase(60), paper)
    assert some.share < 0.4 < all_of_it.share == 1.0
    for name in ("none", "shaper"):
        part, whole = some.contour[name], all_of_it.contour[name]
        assert part.all.count / whole.all.count == pytest.approx(some.share, abs=0.02)
        assert part.rms == pytest.approx(whole.rms, rel=0.1), name


def test_motion_counts_only_where_nothing_is_extruded(paper: Printer) -> None:
    travel = [b"G28\n", b"G1 X10 Y10 Z1 F6000\n", b"G1 X60 Y60\n", b"G1 X20 Y70\n"] * 9
    found = today(travel, paper)
    assert found.contour["none"].rms > 0.02
    assert found.shaping is None
    printed = vase(4)
    alone, both = today(printed, paper), today(travel + printed, paper)
    assert both.contour["none"].rms == pytest.approx(alone.contour["none"].rms, rel=0.02)


def test_a_move_of_days_takes_no_memory(paper: Printer) -> None:
    lines = [b"G28\n", b"M83\n", b"G1 X10 Y10 Z0.2 F6000\n"]
    lines += [b"G1 X270 E1 F12\n", b"G1 X10 E1 F600\n"]
    found = SlicedFile.from_items(Chain(paper, Options("none")).read(lines * 3), paper)
    assert sum(len(path) for path, _ in found.paths) < 200_000, "samples"
