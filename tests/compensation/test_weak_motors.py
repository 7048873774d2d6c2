"""Motors whose limits an owner stated: the print is converted within them, whatever they are."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import TS
from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from hframe_post.stream.chunks import stretches
from hframe_post.stream.types import Samples
from tests.gcode_tools import converted, layers
from tests.quantities import below

OWNERS = Path(__file__).parents[1] / "benchmarks/owners"
STOPS_CLOSE_TOGETHER = b"""\
G28
G90
M83
G1 X120 Y120 Z5 F6000
G1 X117.152 Y122.81 F21000
G1 X121.752 Y122.81 E.12647 F7200
G1 X121.752 Y127.41 E.12647
G1 X117.152 Y127.41 E.12647
G1 X117.152 Y122.87 E.12482
G1 X117.23 Y122.831
G1 E-.56 F1800
G1 X119.152 Y122.844 E-.228 F7200
G1 E-.012 F1800
G1 Z5.4 F21000
G1 X120.111 Y123.719
G1 Z5
G1 E.8 F1800
G1 X120.683 Y124.291 E.02258 F6000
G1 X120.683 Y124.804 E.01429
G1 X119.759 Y123.88 E.03645
G1 X119.247 Y123.88 E.01429
G1 X120.683 Y125.316 E.05667
""".splitlines(keepends=True)


def weak(owner: str, belt_acceleration: float) -> Printer:
    """Return an owner's printer with motors of a stated acceleration, mm/s²."""
    printer = load(str(OWNERS / f"{owner}.toml"))
    return replace(printer, motors=replace(printer.motors, belt_acceleration=belt_acceleration))


def test_stops_that_are_close_together_stay_within_the_motors() -> None:
    options = Options("racking", ("none", "racking"), limits="printer", clamp=False)
    _, report = converted(STOPS_CLOSE_TOGETHER, weak("corexy-10000", 15_000.0), options)
    assert report.peaks.belt_acceleration <= 15_000.0


def hardest(chunks: Iterable[Samples]) -> float:
    """Return the greatest acceleration, mm/s², of the motors A = x + y and B = x − y."""
    most = 0.0
    for stretch in stretches(chunks):
        xy = np.concatenate([chunk.commands["racking"] for chunk in stretch])
        most = max(
            most,
            float(np.abs(np.diff(xy @ [[1.0, 1.0], [1.0, -1.0]], n=2, axis=0)).max(initial=0.0)),
        )
    return most / TS**2


@pytest.mark.slow
@pytest.mark.parametrize("limit", [6_000.0, 9_000.0, 15_000.0])
@pytest.mark.parametrize("owner", ["corexy-3000", "corexy-10000", "hbot-3000"])
def test_a_slice_is_compensated_within_any_motors(owner: str, limit: float) -> None:
    """Moves become slower, so that nothing has to be compensated less."""
    options = Options("racking", ("none", "racking"), limits="printer", clamp=False)
    stream = WholeFile(iter(layers("cube.gcode", 5)), weak(owner, limit), options)
    below(hardest(stream.samples()), limit, "acceleration of a motor, mm/s²")
    report = stream.report
    below(report.contour["racking"].rms, 0.3 * report.contour["none"].rms, "RMS error, mm")


@pytest.mark.slow
@pytest.mark.parametrize("limit", [500.0, 2_000.0])
def test_a_slice_is_converted_where_motors_are_far_too_weak(limit: float) -> None:
    options = Options("racking", ("none", "racking"), limits="printer", clamp=True)
    stream = WholeFile(iter(layers("cube.gcode", 5)), weak("corexy-10000", limit), options)
    below(hardest(stream.samples()), limit, "acceleration of a motor, mm/s²")
