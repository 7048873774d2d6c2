"""Outer walls avoid bands of motor speed: at the nearest speed, on curves and straight lines."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import TS, Array
from hframe_post.conversion.options import Options
from hframe_post.errors import PrinterError
from hframe_post.firmware.registry import firmware
from hframe_post.planner.bands import FASTEST, MARGIN, MotorBands, avoid_bands
from hframe_post.planner.sliced import AsSliced
from hframe_post.printer.profile import load, parse
from hframe_post.printer.settings import Printer
from hframe_post.stream.marks import Mark, Marks
from hframe_post.stream.types import FileLimits, Item, Moves
from tests.gcode_tools import converted
from tests.klipper.host import play
from tests.planner.planning import FREE, cut, moves

COREXY = load("example-corexy")
PRINTER = replace(COREXY, speed=replace(COREXY.speed, avoid=((38.0, 46.0),)))
BELOW, ABOVE = 38.0 * (1.0 - MARGIN), 46.0 * (1.0 + MARGIN)


def wall(points: Iterable[Iterable[float]], speed: float, name: str = "WALL-OUTER") -> Moves:
    """Return moves in the second layer, which extrude 0.04 mm per mm."""
    at = np.array([[*point, 0.4, 0.0] for point in points])
    way = np.hypot(*np.diff(at[:, :2], axis=0).T)
    at[1:, 3] = 0.04 * np.cumsum(way)
    labels = b";LAYER:0", b";LAYER:1", b";TYPE:" + name.encode()
    block = moves(at, speed, marks=Marks.from_lines(Mark(0, text) for text in labels))
    return replace(block, acceleration=np.full(len(way), 3000.0))


def circle(radius: float, speed: float = 30.0, step: float = 0.5) -> Moves:
    angle = np.arange(0.0, 4.0 * math.pi, step / radius)
    return wall(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1), speed)


def bands_of(printer: Printer) -> MotorBands:
    bands = MotorBands.from_profile(printer.speed.avoid, printer.kinematics)
    assert bands is not None
    return bands


def avoided(block: Moves, printer: Printer = PRINTER) -> Array:
    (one,) = avoid_bands(
        [block],
        MotorBands.from_profile(printer.speed.avoid, printer.kinematics),
        firmware(printer).caps(),
    )
    assert isinstance(one, Moves)
    return one.speed


def belts(block: Moves, speed: Array) -> Array:
    """Return the speeds (2, n) of both motors."""
    way = np.diff(block.points[:, :2], axis=0).T
    return np.abs(PRINTER.kinematics.belts(*(way / np.hypot(*way) * speed)))


def test_a_long_line_takes_the_nearest_speed() -> None:
    """On a diagonal one motor turns √2 times as fast as the path; along an axis, as fast."""
    points = [(0, 0), (50, 50), (100, 50)]
    assert avoided(wall(points, 28.0)) == pytest.approx([BELOW / math.sqrt(2.0), 28.0])
    assert avoided(wall(points, 31.0)) == pytest.approx([ABOVE / math.sqrt(2.0), 31.0])
    assert avoided(wall(points, 39.0)) == pytest.approx([39.0, BELOW])


def test_only_outer_walls_change() -> None:
    assert (avoided(wall([(0, 0), (50, 50)], 31.0, "FILL")) == 31.0).all()
    block = wall([(0, 0), (50, 50)], 31.0)
    assert avoided(block, COREXY) is block.speed


@pytest.mark.parametrize("printer", [
    replace(PRINTER, limits=replace(PRINTER.limits, velocity=32.0)),
    replace(PRINTER, limits=replace(PRINTER.limits, flow=3.0)),
])  # fmt: skip
def test_no_speed_rises_above_the_limits(printer: Printer) -> None:
    lower = pytest.approx([BELOW / math.sqrt(2.0)])
    assert avoided(wall([(0, 0), (50, 50)], 31.0), printer) == lower


def test_no_speed_rises_above_the_files_limits_nor_in_the_first_layer() -> None:
    block, lower = wall([(0, 0), (50, 50)], 31.0), pytest.approx([BELOW / math.sqrt(2.0)])
    asked = FileLimits((23.0, math.inf, math.inf, math.inf), FREE.acceleration)
    assert avoided(replace(block, limits=asked)) == lower
    first = Marks.from_lines(mark for mark in block.marks if mark.text != b";LAYER:1")
    assert avoided(replace(block, marks=first)) == lower


def test_no_motor_stays_in_a_band_on_a_curve() -> None:
    for bands in [((38.0, 46.0),), ((20.0, 25.0), (38.0, 46.0)), ((35.0, 40.0), (38.0, 44.0))]:
        printer = replace(PRINTER, speed=replace(PRINTER.speed, avoid=bands))
        known, block = bands_of(printer), circle(20.0)
        speed = avoided(block, printer)
        assert known.contains(belts(block, block.speed)).mean() > 0.3
        assert not known.contains(belts(block, speed)).any()
        assert speed.max() <= FASTEST * 30.0
        assert abs(speed.mean() / 30.0 - 1.0) < 0.04


@pytest.mark.parametrize("size", [1, 7, 50])
def test_speeds_do_not_depend_on_cuts(size: int) -> None:
    block = circle(20.0, step=1.0)
    parts: list[Item] = [
        *avoid_bands(cut(block, size), bands_of(PRINTER), firmware(PRINTER).caps())
    ]
    speed = np.concatenate([part.speed for part in parts if isinstance(part, Moves)])
    np.testing.assert_array_equal(speed, avoided(block))


def test_time_in_bands_as_sliced_is_that_of_the_motion() -> None:
    """Against the samples of a conversion that changes nothing, on a path with corners and arcs."""
    lines = gcode(circle(12.0, 42.0), wall([(0, 0), (30, 3), (30, 40), (0, 0)], 50.0))
    bands = bands_of(PRINTER)
    report = converted(lines, PRINTER, Options("none", clamp=False))[1].bands
    assert report is not None
    assert report.before.total == pytest.approx(
        sum(np.hypot(*np.diff(block.points[:, :2], axis=0).T).sum() / block.speed[0]
            for block in (circle(12.0, 42.0), wall([(0, 0), (30, 3), (30, 40), (0, 0)], 50.0))),
        rel=0.03,
    )  # fmt: skip
    time = AsSliced(firmware(PRINTER).limits(), bands)
    block = circle(12.0, 42.0)
    assert sum(map(len, time.samples([block])))
    steady = bands.contains(belts(block, block.speed)).mean()
    assert time.in_bands.share == pytest.approx(steady, abs=0.02)
    assert report.after.share < 0.3 * report.before.share
    assert report.after.total > TS


def gcode(*blocks: Moves) -> list[bytes]:
    lines = ["G28", "M83", "G1 Z0.2 F600", "M204 S3000", ";LAYER:0", ";LAYER:1"]
    for block in blocks:
        x, y, _, _ = block.points[0]
        lines += [f"G0 X{100 + x:.4f} Y{100 + y:.4f} F6000", ";TYPE:WALL-OUTER"]
        steps = zip(block.points[1:].tolist(), np.diff(block.points[:, 3]), strict=True)
        lines += [
            f"G1 X{100 + x:.4f} Y{100 + y:.4f} E{e:.5f} F{60.0 * block.speed[0]:g}"
            for (x, y, _, _), e in steps
        ]
    return [line.encode() + b"\n" for line in lines]


@pytest.mark.parametrize("value", ["[[46, 38]]", "[38, 46]", "3", "[[1, 2, 3]]", '[["a", 2]]'])
def test_bands_are_checked(value: str) -> None:
    with pytest.raises(PrinterError, match=r"speed\.avoid"):
        parse(f'extends = "example-corexy"\n[speed]\navoid = {value}\n', "name")


# ---------------------------------------------------------------------- on Klipper's host


def motor_speeds(file: Path, folder: Path) -> Array:
    """Return the speeds of A and B (2, n) on the host, every 2 ms while the circle is printed."""
    playback = play(file, workdir=folder)
    assert playback.warnings == ()
    time = np.arange(playback.start, playback.end, 2e-3)
    extrudes = np.diff(playback.extruded(time)) > 0.0
    return PRINTER.kinematics.belts(*np.diff(playback.position(time)[:, :2].T) / 2e-3)[:, extrudes]


@pytest.mark.slow
@pytest.mark.klipper
def test_motors_leave_the_bands_in_as_much_time(tmp_path: Path) -> None:
    lines = gcode(circle(20.0))
    text, report = converted(lines, PRINTER, Options("racking"))
    (sliced := tmp_path / "sliced.gcode").write_bytes(b"".join(lines))
    (changed := tmp_path / "changed.gcode").write_bytes(text)
    before, after = motor_speeds(sliced, tmp_path / "a"), motor_speeds(changed, tmp_path / "b")
    bands = bands_of(PRINTER)
    assert bands is not None
    assert report.bands is not None
    assert bands.contains(before).mean() == pytest.approx(report.bands.before.share, abs=0.03)
    assert bands.contains(before).mean() > 0.4
    assert bands.contains(after).mean() == pytest.approx(report.bands.after.share, abs=0.03)
    assert bands.contains(after).mean() < 0.1
    assert after.shape[1] < 1.04 * before.shape[1]
