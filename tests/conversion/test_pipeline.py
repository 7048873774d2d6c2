"""The whole tool on real slices: nothing lost, in order, on the bed; what a print has today."""

import math
from collections.abc import Callable, Iterable

import numpy as np
import pytest

from hframe_post.conversion import sliced_errors, whole_file
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain
from hframe_post.conversion.sliced_errors import SlicedFile, Today
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.errors import LimitError
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.gcode_tools import assert_same_stream, converted, sample
from tests.same_print import print_of, unstamped

STRICT = Options("racking", clamp=False)


def test_golden_rectangle(paper: Printer, golden: Callable[[str, bytes], bytes]) -> None:
    now = converted(sample("rectangle.gcode"), paper, STRICT)[0]
    assert_same_stream(now, golden("rectangle.gcode", now))


def test_a_fault_at_the_end_comes_before_the_work(paper: Printer) -> None:
    """A move of the end code off the bed was refused after minutes of computing."""
    walls = [b"G1 X%d Y100 E1 F6000\n" % (120 + 20 * (k % 2)) for k in range(20_000)]
    lines = [b"G28\n", b"M83\n", b"G1 X100 Y100 Z1 F6000\n", *walls, b"G1 X0 Y999\n"]
    spans = whole_file.WholeFile(lines, paper, Options("racking")).spans
    with pytest.raises(LimitError, match="line 20004"):
        next(iter(next(iter(spans)).items))


PER_MM = 0.033  # filament
SHAPES: dict[str, list[tuple[float, float]]] = {  # corners on the edges of a bed of 280 by 295 mm
    "along": [(0, 0), (280, 0), (280, 295), (0, 295), (0, 0)],
    "towards": [(100, 50), (1, 60), (0, 80), (0, 200), (1, 210), (100, 295), (200, 295)],
    "zigzag": [(k // 2 % 2 * 3, 60 + 6 * ((k + 1) // 2)) for k in range(50)],
}


def outline(corners: list[tuple[float, float]], speed: float) -> list[bytes]:
    (x, y), *others = corners
    lines = [b"G28\n", b"G90\n", b"M83\n", b"M204 S10000\n"]
    lines.append(b"G1 X%.3f Y%.3f Z0.2 F6000\n" % (x, y))
    for end in others:
        length = ((end[0] - x) ** 2 + (end[1] - y) ** 2) ** 0.5
        x, y = end
        lines.append(b"G1 X%.3f Y%.3f E%.5f F%d\n" % (x, y, PER_MM * length, 60 * speed))
    return lines


@pytest.mark.parametrize(("shape", "speed"), [("along", 50), ("towards", 250), ("zigzag", 250)])
def test_filament_is_never_fed_in_one_place(shape: str, speed: float) -> None:
    lines = outline(SHAPES[shape], speed)
    text, report = converted(lines, load("paper"), Options("racking", clamp=True))
    assert report.clamped.samples > 0
    asked, written = print_of(b"".join(lines)), print_of(unstamped(text))
    assert written.filament == pytest.approx(asked.filament, abs=1e-3)
    assert written.standing == 0.0
    assert written.steepest < 2.0 * PER_MM
    places = np.vstack(written.points)[:, :2]
    assert (places >= -1e-9).all()
    assert (places <= (280.0, 295.0)).all()


@pytest.mark.parametrize("clamp", [False, True])
def test_a_path_beyond_the_bed_is_an_error_always(clamp: bool) -> None:
    lines = [*outline(SHAPES["along"], 50), b"G1 X-0.002 E1\n"]
    with pytest.raises(LimitError, match=r"line 10: x of the path \(mm\)"):
        list(WholeFile(iter(lines), load("paper"), Options("racking", clamp=clamp)).gcode())


def vase(layers: int) -> list[bytes]:
    """A polygon of 40 sides in one stroke, without a stop."""
    angle = np.linspace(0.0, 2.0 * np.pi * layers, 40 * layers + 1)[1:]
    lines = [b"G28\n", b"M83\n", b"G1 X160 Y140 Z0.2 F6000\n", b"M204 S3000\n"]
    for k, turned in enumerate(angle.tolist()):
        place = 130 + 30 * math.cos(turned), 140 + 30 * math.sin(turned), 0.2 + 0.005 * k
        lines.append(b"G1 X%.3f Y%.3f Z%.4f E0.2 F%d\n" % (*place, 2400 + 60 * (k % 97)))
    return lines


def as_sliced(lines: Iterable[bytes], printer: Printer) -> SlicedFile:
    return SlicedFile.from_items(Chain(printer, Options("none")).read(lines), printer)


def today(lines: Iterable[bytes], printer: Printer) -> Today:
    return as_sliced(lines, printer).today()


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
    found = as_sliced(lines * 3, paper)
    assert sum(len(path) for path, _ in found.paths) < 200_000, "samples"
