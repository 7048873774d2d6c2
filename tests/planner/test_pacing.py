"""Pacing: each kind of feature at its pace, the rest as the file has it, filament untouched."""

import math

import numpy as np
import pytest

from hframe_post.firmware.registry import FIRMWARES
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.planner.pacing import Pace, Paces, pace
from hframe_post.stream.features import KINDS, OTHER, kind
from hframe_post.stream.types import Item, Moves
from tests.planner.planning import cut

PRINT = """\
M201 X1000 Y500
M204 S3000
G28
M83
G1 X0 Y0 Z0.2 F6000
;LAYER:0
;TYPE:WALL-OUTER
G1 X10 E0.5 F1800
;LAYER:1
G1 X20 Z0.21 E0.5
;TYPE:FILL
G1 X30 E0.5
G0 X40 F9000
;TYPE:WALL-OUTER
G1 Y10 E5 F1800
;LAYER:2
;TYPE:BRIDGE
G1 X0 Z0.22 E0.5
""".splitlines(keepends=True)

WALL, FILL, GONE = Pace(8000.0, 8.0, 2.0), Pace(20000.0, 10.0, 4.0), Pace(15000.0, 9.0, 1.0)


def paced(paces: Paces) -> Moves:
    lines = [line.encode() for line in PRINT]
    items = pace(read(lines, ReadOptions(FIRMWARES["klipper"].dialect, "file-all")), paces)
    (moves,) = (item for item in items if isinstance(item, Moves))
    return moves


def test_each_kind_has_its_pace_and_the_rest_is_the_files() -> None:
    moves = paced(Paces({"outer-wall": WALL, "infill": FILL, "travel": GONE}))
    # the first layer and the bridge are the file's: 3000, of which M201 leaves 1000 in x
    asked = [1000.0, 8000.0, 20000.0, 15000.0, 8000.0, 1000.0]
    np.testing.assert_allclose(moves.acceleration, asked, rtol=1e-6)
    assert moves.speed.tolist() == [30.0, 60.0, 120.0, 150.0, 60.0, 30.0]
    assert moves.corner.tolist() == [math.inf, 8.0, 10.0, 9.0, 8.0, math.inf]
    assert set(moves.limits.acceleration) == {math.inf}


def test_no_faster_than_the_hot_end_melts_but_never_slower_than_the_file() -> None:
    """0.5 mm on 10 mm at 60 mm/s are 3 mm of filament a second, 5 mm are 30."""
    moves = paced(Paces({"outer-wall": WALL}, flow=2.0))
    assert moves.speed[1] == pytest.approx(40.0)
    assert moves.speed[4] == pytest.approx(30.0)  # as the file has it, which is too fast already


def test_the_extruder_is_not_accelerated_beyond_its_bound_but_by_the_file() -> None:
    """0.5 mm on 10 mm at 8000 mm/s² are 400 mm/s² of filament."""
    moves = paced(Paces({"outer-wall": WALL, "travel": GONE}, filament_acceleration=300.0))
    assert moves.acceleration[1] == pytest.approx(6000.0)
    assert moves.acceleration[3] == GONE.acceleration
    moves = paced(Paces({"outer-wall": WALL}, filament_acceleration=1.0))
    assert moves.acceleration.tolist() == paced(Paces({})).acceleration.tolist()


def test_a_layer_can_be_slowed() -> None:
    moves = paced(Paces({"outer-wall": WALL, "infill": FILL}, layers={2: 0.5}))
    assert moves.speed.tolist() == [30.0, 30.0, 60.0, 150.0, 30.0, 30.0]
    kept = paced(Paces({"outer-wall": WALL, "infill": FILL}, layers={2: 0.5}, min_speed=40.0))
    assert kept.speed.tolist() == [30.0, 40.0, 60.0, 150.0, 40.0, 30.0]


def test_what_lies_as_low_as_the_first_layer_keeps_what_the_file_has() -> None:
    """The first layer of a second object, whatever the slicer counts, and not as low as a lift."""
    text = [line.encode() for line in PRINT]
    text.insert(text.index(b";LAYER:1\n"), b"G0 X11 Z3 F9000\n")
    text += [b";LAYER:0\n", b";TYPE:FILL\n", b"G1 X5 Z0.2 E0.5\n", b"G1 X9 Z0.21 E0.5\n"]
    items = pace(read(text, ReadOptions(FIRMWARES["klipper"].dialect)), Paces({"infill": FILL}))
    (moves,) = (item for item in items if isinstance(item, Moves))
    assert moves.acceleration[-2:].tolist() == [3000.0, 20000.0]


def test_filament_and_path_stay_and_cuts_change_nothing() -> None:
    chosen = Paces({"outer-wall": WALL, "infill": FILL, "travel": GONE}, 4.0, 1, {2: 0.7})
    whole = paced(chosen)
    bare = paced(Paces({}))
    np.testing.assert_array_equal(whole.points, bare.points)
    for size in (1, 2, 5):
        lines = [line.encode() for line in PRINT]
        items: list[Item] = []
        for item in read(lines, ReadOptions(FIRMWARES["klipper"].dialect, "file-all")):
            items += cut(item, size) if isinstance(item, Moves) else [item]
        pieces = [item for item in pace(items, chosen) if isinstance(item, Moves)]
        assert len(pieces) > 1
        for name in ("speed", "acceleration", "corner", "line"):
            joined = np.concatenate([getattr(moves, name) for moves in pieces])
            np.testing.assert_array_equal(joined, getattr(whole, name))


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
