"""Pacing: accelerations and corners times a factor; the first layer, bridges and filament stay."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain
from hframe_post.firmware.registry import FIRMWARES
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.planner.pacing import Pace
from hframe_post.printer.profile import load
from hframe_post.printer.settings import RACKING_WALLS, Printer
from hframe_post.stream.features import KINDS, OTHER, kind
from hframe_post.stream.types import Item, Moves, Plan
from tests.gcode_tools import converted
from tests.quantities import below

PRINT = """\
M201 X1000 Y500
M204 S3000
M205 X8 Y8
G28
M83
G1 X0 Y0 Z0.2 F6000
;LAYER:0
;TYPE:WALL-OUTER
G1 X10 E0.5 F1800
;LAYER:1
G1 X20 Z0.21 E0.5
;TYPE:FILL
G1 Y10 E0.5
;LAYER:2
;TYPE:BRIDGE
G1 X0 Z0.22 E0.5
""".splitlines(keepends=True)


def asked() -> list[Item]:
    lines = [line.encode() for line in PRINT]
    return list(read(lines, ReadOptions(FIRMWARES["klipper"].dialect, "file-all")))


def paced(pace: Pace) -> list[Moves]:
    return [item for item in pace.items(asked()) if isinstance(item, Moves)]


def test_all_but_the_first_layer_and_bridges_is_raised_up_to_what_the_motors_allow() -> None:
    (moves,) = paced(Pace(4.0, 3500.0, 20.0))
    # of 3000, M201 leaves 1000 in x and 500 in y
    np.testing.assert_allclose(moves.acceleration, [1000.0, 3500.0, 2000.0, 1000.0], rtol=1e-6)
    assert moves.corner.tolist() == [8.0, 20.0, 20.0, 8.0]
    assert set(moves.limits.acceleration) == {math.inf}
    (bare,) = paced(Pace())
    for name in ("points", "speed"):
        np.testing.assert_array_equal(getattr(moves, name), getattr(bare, name))


def test_what_the_file_asks_for_beyond_that_stays_and_a_gentler_pace_is_for_all() -> None:
    (moves,) = paced(Pace(2.0, 700.0, 5.0))
    np.testing.assert_allclose(moves.acceleration, [1000.0, 1000.0, 700.0, 1000.0], rtol=1e-6)
    assert moves.corner.tolist() == [8.0] * 4
    (moves,) = paced(Pace(0.5))
    np.testing.assert_allclose(moves.acceleration, [500.0, 500.0, 250.0, 500.0], rtol=1e-6)
    assert moves.corner.tolist() == [4.0] * 4


@pytest.mark.parametrize(
    ("printer", "strategy", "pace", "share"),
    [
        ("example-hbot", "racking", 1.0, RACKING_WALLS), ("example-hbot", "none", 1.0, 1.0),
        ("example-hbot", "racking", 2.0, 2.0), ("example-corexy", "racking", 1.0, 1.0),
        ("paper", "racking", 1.0, 1.0),
    ],
)  # fmt: skip
def test_outer_walls_are_gentle_where_racking_is_compensated(
    printer: str, strategy: str, pace: float, share: float
) -> None:
    """Only what they extrude, and no other feature; a pace that is asked for replaces it."""
    lines = [b"M204 S1000\n", b"G28\n", b"M83\n", b"G1 X0 Y0 Z0.2 F6000\n", b";LAYER:0\n"]
    lines += [b";LAYER:1\n", b";TYPE:WALL-OUTER\n", b"G1 X20 E1\n", b"G0 X40 Y20\n"]
    lines += [b";TYPE:FILL\n", b"G1 X60 E1\n"]
    options = Options(strategy, pace=pace, force=True)
    (plan,) = (
        item for item in Chain(load(printer), options).planned(lines) if isinstance(item, Plan)
    )
    line = plan.line[plan.ends[:-1]]
    asked = [plan.acceleration[line == each].max() for each in (8, 9, 11)]
    np.testing.assert_allclose(asked, [share * 1000.0, pace * 1000.0, pace * 1000.0], rtol=1e-6)


def test_limits_of_a_profile_at_a_pace(paper: Printer) -> None:
    own = paper.limits
    assert Pace().limits(own) is own
    raised = Pace(3.0, 2.0 * own.acceleration).limits(own)
    assert raised.acceleration == 2.0 * own.acceleration
    assert raised.jerk == 3.0 * own.jerk
    assert raised.square_corner_velocity == 3.0 * own.square_corner_velocity
    assert (raised.velocity, raised.z_acceleration) == (own.velocity, own.z_acceleration)


@pytest.mark.parametrize("acceleration", [6000, 11000, 20000])
def test_a_fast_printer_takes_no_longer_for_short_moves_than_its_firmware(
    acceleration: int,
) -> None:
    """Rounded corners of chords of 0.9 mm; with a jerk of 1e7, 4.0 % longer at 20 000 mm/s²."""
    printer = load("example-corexy")
    fast = replace(printer.limits, acceleration=20000.0, jerk=0.0)
    turn = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    middle = np.repeat([[40.0, 40.0], [0.0, 40.0], [0.0, 0.0], [40.0, 0.0]], 10, axis=0)
    places = (100.0 + middle + 5.0 * np.column_stack([np.cos(turn), np.sin(turn)])).tolist()
    lines = [b"M204 S%d\n" % acceleration, b"G28\n", b"M83\n", b"G1 X100 Y100 Z0.2 F18000\n"]
    lines += [b"G1 X%.3f Y%.3f E0.03\n" % (x, y) for x, y in places] * 20
    report = converted(lines, replace(printer, limits=fast), Options("none"))[1]
    below(report.time.after, report.time.before, "print time, s")


@pytest.mark.parametrize(
    ("name", "means"),
    [
        ("WALL-OUTER", "outer-wall"), ("External perimeter", "outer-wall"),
        ("Outer wall", "outer-wall"), ("Perimeter", "inner-wall"), ("WALL-INNER", "inner-wall"),
        ("Overhang perimeter", "bridge"), ("Internal Bridge", "bridge"),
        ("Bridge infill", "bridge"), ("Internal infill", "infill"), ("FILL", "infill"),
        ("Gap infill", "infill"), ("Solid infill", "skin"), ("Top solid infill", "skin"),
        ("Internal solid infill", "skin"), ("Bottom surface", "skin"), ("SKIN", "skin"),
        ("SUPPORT-INTERFACE", "interface"), ("Support material interface", "interface"),
        ("SUPPORT", "support"), ("Skirt/Brim", "skirt"), ("Prime tower", "skirt"),
        ("Ironing", "ironing"), ("Custom", "skirt"), ("Sonstiges", OTHER),
    ],
)  # fmt: skip
def test_slicers_names_of_features(name: str, means: str) -> None:
    assert kind(name) == means
    assert means in (*KINDS, OTHER)
