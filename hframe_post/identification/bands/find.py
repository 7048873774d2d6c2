"""Bands of speed in which a motor shakes the nozzle more than at the speeds around them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array
from hframe_post.identification.bands.shaking import MotorShaking

STEP = 0.5  # mm/s, between speeds
AROUND = 1.6  # factor on the speed, up and down, within which the usual shaking is the median
PEAK, EDGE = 1.5, 1.25  # times the usual shaking: at the worst speed of a band, at its ends
WIDEST = 1.45  # greatest over least speed of a band; what is wider cannot be avoided
FAINT = 0.3  # of the strongest peak; fainter ones do not count
SLOWEST = 20.0  # mm/s at the belt
MOST = 4  # bands of a motor


@dataclass(frozen=True, slots=True)
class Band:
    """Speeds of a motor from least to greatest, mm/s at the belt.

    worst: the speed in it that shakes most. rms, usual: there, and at speeds around, mm.
    """

    motor: int
    least: float
    greatest: float
    worst: float
    rms: float
    usual: float


def bands(motors: Iterable[MotorShaking]) -> list[Band]:
    """Return the bands of all motors, by motor and speed."""
    return [band for motor in motors for band in _of_motor(motor)]


def to_avoid(found: Sequence[Band]) -> tuple[tuple[int, int], ...]:
    """Return the bands that a profile avoids, for both motors: whole mm/s, those that meet joined.

    Two that would become wider than WIDEST when joined stay apart by 1 mm/s.
    """
    joined = list[tuple[int, int]]()
    for band in sorted(found, key=lambda one: one.least):
        least, greatest = math.floor(band.least), math.ceil(band.greatest)
        if joined and least <= joined[-1][1]:
            low, high = joined[-1]
            if max(greatest, high) <= WIDEST * low:
                joined[-1] = (low, max(greatest, high))
                continue
            least = high + 1
            if greatest <= least:
                continue
        joined.append((least, greatest))
    return tuple(joined)


def _of_motor(shaking: MotorShaking) -> Iterator[Band]:
    speed = np.arange(shaking.speed[0], shaking.speed[-1] + STEP / 2.0, STEP)
    rms = np.interp(speed, shaking.speed, shaking.rms)
    usual = np.array([
        np.median(rms[(speed >= s / AROUND) & (speed <= s * AROUND)]) for s in speed
    ])  # fmt: skip
    over, free = rms / usual, speed >= SLOWEST
    found = list[Band]()
    while len(found) < MOST and free.any():
        k = int(np.flatnonzero(free)[np.argmax((rms - usual)[free])])
        if over[k] < PEAK:
            break
        low, high = _edges(speed, over, k)
        free[low : high + 1] = False
        here = (float(value) for value in (*speed[[low, high, k]], rms[k], usual[k]))
        found.append(Band(shaking.motor, *here))
    strongest = max((band.rms - band.usual for band in found), default=0.0)
    yield from sorted(
        (band for band in found if band.rms - band.usual >= FAINT * strongest),
        key=lambda band: band.least,
    )


def _edges(speed: Array, over: Array, peak: int) -> tuple[int, int]:
    """Return where a band around its worst speed begins and ends.

    It grows to the side that shakes more, until both shake little more than usual or it is WIDEST.
    """
    low = high = peak
    while True:
        below = over[low - 1] if low else 0.0
        above = over[high + 1] if high + 1 < len(over) else 0.0
        if max(below, above) < EDGE:
            return low, high
        low, high = (low - 1, high) if below > above else (low, high + 1)
        if speed[high] > WIDEST * speed[low]:
            return (low + 1, high) if below > above else (low, high - 1)
