"""Thin square walls to print: one tower in bands of several speeds, or three low squares in a row.

Behind a corner a wall shows the waves of the axis that has just stopped there:

    right and left wall: x      front and back wall: y
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import dist, pi

import numpy as np

from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.errors import HframeError
from hframe_post.firmware.code import Code, plain
from hframe_post.firmware.registry import firmware
from hframe_post.gcode.commands import OFF, STAMP
from hframe_post.model.plant import Plant
from hframe_post.printer.settings import Limits, Printer
from hframe_post.stream.types import ModalState
from hframe_post.version import __version__

SIDE, GAP = 60.0, 15.0  # mm of the tower; between three squares, and to the edge of the bed
LAYER, WIDTH = 0.2, 0.5  # mm
LAYERS, LOW = 20, 10  # of a band; of a low square, over which the print head can pass
SPEEDS = (60.0, 100.0, 150.0)  # mm/s of bands, as far as the printer reaches them
HARD, SOFT = 20.0, 0.4  # mm/s at corners, and the share of it at soft ones
BRIM, FIRST, TRAVEL = 4, 30.0, 100.0  # lines around the first layer; mm/s
HARDEST_JERK = 5e7  # mm/s³, of squares to compare

COLD = ["M82", "G92 E0", "M104 S0", "M140 S0", "M106 S0"]  # and E as firmwares begin with it
Place = tuple[float, float]  # x and y, mm
Heat = tuple[float, float]  # °C of nozzle and bed


@dataclass(frozen=True, slots=True)
class Band:
    """A part of the wall: its speed and that of its corners, mm/s."""

    speed: float
    corner: float


def bands(printer: Printer) -> list[Band]:
    """Return the bands of a tower, from the bottom; the last has soft corners."""
    limits = printer.limits
    a, (hard, soft) = limits.acceleration, _corners(printer)
    fastest = min(limits.velocity, limits.flow / (LAYER * WIDTH), np.sqrt(0.5 * SIDE * a))
    speeds = [v for v in SPEEDS if v <= fastest]  # on half of a wall at full speed
    if len(speeds) == 2:  # three tell which reading is wrong
        speeds.insert(1, sum(speeds) / 2.0)
    if not speeds:
        raise HframeError(
            f"at {limits.velocity:g} mm/s and {a:g} mm/s² no waves would show: the profile needs "
            f"limits of {SPEEDS[0]:g} mm/s and {2.0 * SPEEDS[0] ** 2 / SIDE:g} mm/s²"
        )
    return [*(Band(v, hard) for v in speeds), Band(speeds[-1], soft)]


def _corners(printer: Printer) -> tuple[float, float]:
    """Return the mm/s of hard and of soft corners, as far as the firmware takes them."""
    least, most = _code(printer).corner_range(printer.limits.acceleration)
    hard = min(HARD, most)
    return hard, min(max(SOFT * hard, least), hard)


def tower(printer: Printer, heat: Heat) -> list[str]:
    """Return the G-code of the tower, which the firmware plays without compensation.

    Raises HframeError if it does not fit onto the bed.
    """
    (x, y), needed = middle(printer), SIDE + 2.0 * GAP
    if min(np.ptp(printer.travel.x), np.ptp(printer.travel.y)) < needed:
        raise HframeError(f"the bed must be at least {needed:g} mm wide and deep")
    lines = [
        OFF.decode(),
        f"; waves to measure, hframe-post {__version__}",
        *heated(printer, heat),
    ]
    for k, band in enumerate(bands(printer)):
        lines += [f"; band {k + 1}: {band.speed:g} mm/s"]
        lines += _limits(printer, printer.limits.acceleration, band.corner)
        lines += _square(printer, (x, y), SIDE, band.speed, range(k * LAYERS, (k + 1) * LAYERS))
    top = len(bands(printer)) * LAYERS * LAYER + GAP
    state = ModalState(True, False, 0.0, TRAVEL, (0.0, 0.0, 0.0))
    end = _code(printer).end(state, np.array([x, y, top, 0.0]))
    return [*lines, f"G1 Z{plain(top, 2)} F600", *end, *COLD]


def _code(printer: Printer) -> Code:
    return firmware(printer).code()


def _limits(printer: Printer, acceleration: float, corner: float) -> list[str]:
    """Return commands for mm/s² and the mm/s of corners, without input shaping."""
    return _code(printer).set_limits(printer.limits.velocity, acceleration, corner)


def heated(printer: Printer, heat: Heat) -> list[str]:
    """Return the commands that heat and home the printer."""
    nozzle, bed = (plain(one, 0) for one in heat)
    return [f"M140 S{bed}", f"M190 S{bed}", "G28", *_code(printer).after_homing,
            f"M104 S{nozzle}", f"M109 S{nozzle}", "M106 S128", "G90", "M83"]  # fmt: skip


def _square(
    printer: Printer, middle: Place, side: float, speed: float, layers: range
) -> Iterator[str]:
    """Yield layers of a square, with a brim."""
    low, high = ((middle[0] + half, middle[1] + half) for half in (-side / 2.0, side / 2.0))
    for layer in layers:
        yield from _brim(printer, low, high) if layer == 0 else [_height(layer)]
        yield from _loop(printer, low, high, FIRST if layer == 0 else speed)


def _brim(printer: Printer, low: Place, high: Place) -> Iterator[str]:
    """Yield lines on the bed around a rectangle between two corners, from the outermost."""
    yield travel(*(at - BRIM * WIDTH for at in low))  # it may pass above another wall
    yield _height(0)
    for w in (k * WIDTH for k in range(BRIM, 0, -1)):
        yield from _loop(printer, (low[0] - w, low[1] - w), (high[0] + w, high[1] + w), FIRST)


def _loop(printer: Printer, low: Place, high: Place, speed: float) -> Iterator[str]:
    """Yield a rectangle, counter-clockwise from the front left corner."""
    yield travel(*low)
    yield from extruded(printer, [low, (high[0], low[1]), high, (low[0], high[1]), low], speed)


def extruded(printer: Printer, places: Sequence[Place], speed: float) -> Iterator[str]:
    """Yield moves that extrude from the first place to the others in turn."""
    for start, (x, y) in pairwise(places):
        volume = LAYER * WIDTH * dist(start, (x, y))
        fed = volume / (pi / 4.0 * printer.limits.filament_diameter**2)
        yield f"G1 X{plain(x, 3)} Y{plain(y, 3)} E{plain(fed, 5)} F{plain(speed * 60.0, 0)}"


def _height(layer: int) -> str:
    return f"G1 Z{plain((layer + 1) * LAYER, 2)} F600"


def travel(x: float, y: float) -> str:
    """Return a move to a place without extrusion."""
    return f"G0 X{plain(x, 3)} Y{plain(y, 3)} F{plain(TRAVEL * 60.0, 0)}"


def middle(printer: Printer) -> Place:
    """Return the middle of the bed."""
    return round(sum(printer.travel.x) / 2.0, 1), round(sum(printer.travel.y) / 2.0, 1)


# ---------------------------------------------------------------------- three squares


def squares(printer: Printer, plants: Sequence[Plant], heat: Heat) -> list[bytes]:
    """Return the G-code of squares from left to right, each compensated for another plant.

    Their corners are as hard as the tower's, so that what is left of the waves shows, or as hard as
    the motors allow: a clamp would hide what the plants differ in. Raises HframeError.
    """
    limits, corner = printer.limits, _corners(printer)[0]
    hard = replace(limits, square_corner_velocity=corner)
    for tried in (replace(hard, jerk=HARDEST_JERK), hard):
        pieces, clamped = _squares(printer, plants, heat, tried)
        if not clamped:
            return pieces
    return _squares(printer, plants, heat, limits)[0]


def _squares(
    printer: Printer, plants: Sequence[Plant], heat: Heat, limits: Limits
) -> tuple[list[bytes], bool]:
    """Return the G-code, and whether less than all is compensated somewhere."""
    n, (x, y) = len(plants), middle(printer)
    side = min(SIDE, (float(np.ptp(printer.travel.x)) - (n + 1) * GAP) / n)
    if side < SIDE / 2.0 or np.ptp(printer.travel.y) < side + 2.0 * GAP:
        raise HframeError(f"the bed is too small for {n} squares of {SIDE / 2.0:g} mm in a row")
    speed, above = bands(printer)[-1].speed, f"G1 Z{plain(LOW * LAYER + 3.0, 1)} F600"
    head = [OFF.decode(), f"; {n} squares to compare, hframe-post {__version__}"]
    pieces, clamped = ["\n".join([*head, *heated(printer, heat), ""]).encode()], False
    for k, plant in enumerate(plants):
        at = round(x + (k - (n - 1) / 2.0) * (side + GAP), 1), y
        walls = _square(printer, at, side, speed, range(LOW))
        text = (f"{line}\n".encode() for line in ("G90", "M83", above, *walls, above))
        own = replace(printer, plant=plant, limits=limits)
        conversion = WholeFile(text, own, Options("racking", clamp=True))
        for piece in conversion.gcode():
            if isinstance(piece, bytes) and not piece.startswith(STAMP):
                pieces.append(piece)
        clamped |= conversion.report.clamped.samples > 0
    return [*pieces, "\n".join([*COLD, ""]).encode()], clamped
