"""Layers and features of every sample, as the slicer's comments tell."""

import numpy as np
import pytest

from hframe_post.prediction.statistics import BEFORE, TRAVEL
from hframe_post.stream.types import Dwell, MoveAtRest, Samples
from tests.prediction.label_tools import block, names, printing


def test_comments_hold_from_their_sample_on() -> None:
    comments = [(1, b";LAYER:0\n"), (2, b";TYPE:SKIRT\n"), (4, b";LAYER:1\n"), (5, b";TYPE:FILL\n")]
    layers, features = names([block(printing(6), *comments)])
    assert layers == [BEFORE, "0", "0", "0", "1", "1"]
    assert features == [BEFORE, BEFORE, "SKIRT", "SKIRT", "SKIRT", "FILL"]


LAYERS = {
    b";LAYER:12": "12", b";LAYER:-3\r\n": "-3", b"; LAYER: 7\n": "7", b"  ;LAYER:7\n": "7",
    b";LAYER_CHANGE\r\n": "0", b"; CHANGE_LAYER\n": "0",
    b"; layer num/total_layer_count: 3/200": "2",  # Bambu Studio counts from 1
    b"; layer 3, Z = 0.600": "3",  # Simplify3D
    b"; BEGIN_LAYER_OBJECT z=0.350 z_thickness=0.200": "0",  # KISSlicer
    b";; --- layer 4 (0.200 @ 1.000) ---": "4",  # Kiri:Moto
    b";layer:0.30": "0",  # FlashPrint
    b"(Slice 6, 1 Extruder)": "6", b"; Slice 6, 1 Extruder": "6",  # MakerBot
}  # fmt: skip
FEATURES = {
    b";TYPE:WALL-OUTER\n": "WALL-OUTER", b";TYPE:External perimeter\r\n": "External perimeter",
    b"; FEATURE: Outer wall \n": "Outer wall", b";TYPE:Au\xc3\x9fen\n": "Außen",
    b";TYPE:\xff\n": "\ufffd",
    b"; feature outer perimeter": "outer perimeter",  # Simplify3D
    b"; 'Perimeter Path', 0.6 [feed mm/s], 35.0 [head mm/s]": "Perimeter Path",  # KISSlicer
    b";structure:shell-outer": "shell-outer",  # FlashPrint
}  # fmt: skip
OTHERS = [
    b";LAYER_COUNT:40", b";LAYER:", b";LAYER:first", b";LAYERS:3", b";LAYER_CHANGED", b";Z:0.2",
    b";HEIGHT:0.2", b";TYPE:", b";TYPE: \n", b"LAYER:3", b"M117 ;LAYER:3", b";type:FILL", b";", b"",
    b"; layer_height = 0.2", b";Layer height: 0.2", b"; layer count: 7",
    b"; total layer number: 92", b";AFTER_LAYER_CHANGE",
]  # fmt: skip


@pytest.mark.parametrize("text", [*LAYERS, *FEATURES, *OTHERS])
def test_layers_and_features_as_slicers_write_them(text: bytes) -> None:
    expected = [LAYERS.get(text, BEFORE)], [FEATURES.get(text, BEFORE)]
    assert names([block(printing(1), (0, text))]) == expected


def test_a_layer_without_a_number_follows_the_one_before() -> None:
    comments = [(0, b";LAYER:6"), (1, b";LAYER_CHANGE"), (2, b";LAYER:6"), (3, b";LAYER_CHANGE")]
    assert names([block(printing(4), *comments)])[0] == ["6", "7", "6", "7"]


def test_a_number_too_long_is_not_a_layer() -> None:
    comments = [(0, b";LAYER:" + b"9" * 5000), (1, b";LAYER_CHANGE")]
    assert names([block(printing(2), *comments)])[0] == [BEFORE, "0"]


def test_motion_without_filament_is_travel_whatever_the_comment() -> None:
    e = [1.0, 2.0, 2.0, 1.5, 1.6, 1.6]
    features = names([block(e, (0, b";TYPE:FILL"))])[1]
    assert features == ["FILL", "FILL", TRAVEL, TRAVEL, "FILL", TRAVEL]


def test_comments_between_stops_count_like_those_in_motion() -> None:
    comments = [(1, b";LAYER:2"), (2, b";TYPE:FILL")]
    marked, paused = (names([block(printing(4), *comments, paused=p)]) for p in (False, True))
    assert marked == paused
    retraction = Dwell(0, 0, MoveAtRest(1, (0, 0, 0, 1), (0, 0, 0, 0), 30.0))
    still = Samples(0, np.ones((1, 4)), np.zeros(1, np.int64), (retraction,))
    assert names([still]) == ([BEFORE], [BEFORE])


def test_both_marks_of_bambu_studio_are_one_layer() -> None:
    comments = [
        (2 * k + j, text % (k + 1) if b"%" in text else text)
        for k in range(3)
        for j, text in enumerate((b"; CHANGE_LAYER", b"; layer num/total_layer_count: %d/3"))
    ]
    assert names([block(printing(7), *comments)])[0] == ["0", "0", "1", "1", "2", "2", "2"]
