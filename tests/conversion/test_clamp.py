"""At the edge of the bed: what is clamped keeps its filament along the way; no path is clamped."""

import numpy as np
import pytest

from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.options import Options
from hframe_post.errors import LimitError
from hframe_post.printer.profile import load
from tests.gcode_tools import converted
from tests.same_print import print_of, unstamped

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
        list(GcodeConversion(iter(lines), load("paper"), Options("racking", clamp=clamp)))
