"""Pieces that represent a print: every kind of feature, from everywhere, of limited length."""

from collections.abc import Iterable, Iterator

import numpy as np
import pytest

from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Moves
from hframe_post.studies.inputs import Piece, excerpt
from tests.conftest import SAMPLES


def pieces_of(
    paper: Printer, lines: Iterable[bytes], seconds: tuple[float, float] = (40.0, 100.0)
) -> list[Piece]:
    return excerpt(read(lines, ReadOptions.from_printer(paper)), seconds=seconds)


def seconds(pieces: list[Piece]) -> dict[str, float]:
    names = {name for piece in pieces for name in piece.seconds}
    return {name: sum(piece.seconds.get(name, 0.0) for piece in pieces) for name in names}


@pytest.fixture(scope="module")
def cube(paper: Printer) -> list[Piece]:
    return pieces_of(paper, (SAMPLES / "cube.gcode").read_bytes().splitlines(keepends=True))


def test_every_kind_and_all_heights_but_the_first_are_kept(cube: list[Piece]) -> None:
    kept = seconds(cube)
    assert {"outer-wall", "inner-wall", "skin", "infill"} <= set(kept)
    assert min(kept[name] for name in ("outer-wall", "inner-wall", "skin", "infill")) > 5.0
    layers = [piece.start.place.layer for piece in cube]
    assert layers == sorted(layers)
    assert layers[0] >= 1
    assert max(layers) > 80
    points = np.concatenate(
        [item.points for piece in cube for item in piece.items if isinstance(item, Moves)]
    )
    assert points[:, 2].min() > 0.35  # the first layer is at 0.3


def test_no_more_is_kept_of_a_longer_print(paper: Printer) -> None:
    """A wall without end: each time it gets twice as long, every other piece is dropped."""

    def wall(turns: int) -> Iterator[bytes]:
        yield from (b"G28\n", b"M83\n", b"G1 X50 Y50 Z0.2 F6000\n", b";LAYER:0\n", b"G1 X51 E1\n")
        yield from (b";LAYER:1\n", b";TYPE:WALL-OUTER\n")
        for turn in range(turns):
            for x, y in ((90, 50), (90, 90), (50, 90), (50, 50)):
                yield b"G1 X%d Y%d Z%.3f E1 F2400\n" % (x, y, 0.4 + 1e-3 * turn)

    short, long = (pieces_of(paper, wall(turns), (20.0, 20.0)) for turns in (100, 800))
    for pieces, height in ((short, 0.5), (long, 1.2)):
        assert 15.0 <= sum(seconds(pieces).values()) <= 45.0
        heights = [
            piece.items[0].points[0, 2] for piece in pieces if isinstance(piece.items[0], Moves)
        ]
        assert max(heights) > 0.8 * height
