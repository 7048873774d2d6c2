"""At the edge of the bed: what is clamped keeps its filament along the way; no path is clamped."""

from __future__ import annotations

import pytest

from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.options import Options
from hframe_post.errors import LimitError
from hframe_post.printer.profile import load
from hframe_post.writers.stream.print_time import DeferredLine
from tests.fuzz.machine import Machine

PER_MM = 0.033  # filament
SHAPES: dict[str, list[tuple[float, float]]] = {  # corners on the edges of a bed of 280 by 295 mm
    "along": [(0, 0), (280, 0), (280, 295), (0, 295), (0, 0)],
    "towards": [(100, 50), (1, 60), (0, 80), (0, 200), (1, 210), (100, 295), (200, 295)],
    "zigzag": [(k // 2 % 2 * 3, 60 + 6 * ((k + 1) // 2)) for k in range(50)],
}


def print_of(corners: list[tuple[float, float]], speed: float) -> list[bytes]:
    (x, y), *others = corners
    lines = [
        b"G28\n",
        b"G90\n",
        b"M83\n",
        b"M204 S10000\n",
        b"G1 X%.3f Y%.3f Z0.2 F6000\n" % (x, y),
    ]
    for end in others:
        length = ((end[0] - x) ** 2 + (end[1] - y) ** 2) ** 0.5
        x, y = end
        lines.append(b"G1 X%.3f Y%.3f E%.5f F%d\n" % (x, y, PER_MM * length, 60 * speed))
    return lines


@pytest.mark.parametrize("speed", [50, 250])
@pytest.mark.parametrize("shape", SHAPES)
def test_filament_is_never_fed_in_one_place(shape: str, speed: float) -> None:
    lines = print_of(SHAPES[shape], speed)
    conversion = GcodeConversion(iter(lines), load("paper"), Options("racking", clamp=True))
    pieces = list(conversion)
    text = b"".join(o.line + b"\n" if isinstance(o, DeferredLine) else o for o in pieces)
    asked, written = Machine("klipper").play(b"".join(lines)), Machine("klipper").play(text)
    assert conversion.report().clamped.samples > 0
    assert written.filament == pytest.approx(asked.filament, abs=1e-3)
    assert written.standing == 0.0
    assert written.steepest < 2.0 * PER_MM
    assert min(written.least) >= -1e-9
    assert written.greatest[0] <= 280.0
    assert written.greatest[1] <= 295.0


@pytest.mark.parametrize("clamp", [False, True])
def test_a_path_beyond_the_bed_is_an_error_always(clamp: bool) -> None:
    lines = [*print_of(SHAPES["along"], 50), b"G1 X-0.002 E1\n"]
    with pytest.raises(LimitError, match=r"line 10: x of the path \(mm\)"):
        list(GcodeConversion(iter(lines), load("paper"), Options("racking", clamp=clamp)))
