"""Motors whose limits an owner stated: the print is converted within them, whatever they are."""

from dataclasses import replace
from pathlib import Path

from hframe_post.conversion.options import Options
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.gcode_tools import converted

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
