"""Recordings of accelerometers: even samples in mm/s².

A sensor at rest shows gravity, upwards, plus its own offset. From gravity follows the unit of a
file.

A sensor takes its samples evenly, by an oscillator of its own, and a program estimates when. These
estimates may wander: those of Klipper by 10 ms around the true times of a LIS2DW at 400 Hz, and by
40 ms in the first seconds. At 40 Hz that is a whole turn. Numbers of samples do not wander.

An oscillator changes its rate slowly, by 43 ms in (100 s)² at the most that was seen. So its stamps
lie on a parabola over a second; stamps that a program guessed do not. In their place a steady rate
explains as much of four recordings of a LIS2DW as one that bends every 15 s, or more.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter

from hframe_post.arrays import Array, Integers
from hframe_post.errors import IdentificationError
from hframe_post.identification import verdict
from hframe_post.identification.recordings.formats import Table

GAP = 2.5  # sample periods between neighbours, from which samples are missing
# s by which the mean stamps of 0.1 s may be off a parabola over a second, by their median: 2 to
# 5 µs on 15 recordings of an ADXL345, 18 µs on those of 2 s; 65 to 122 µs on four of a LIS2DW
WANDER_S = 3e-5


def repaired(t: Array, a: Array) -> tuple[Array, Array, tuple[str, ...]]:
    """Return times (n,) in s and accelerations (n, 3) of even samples, and notes of the changes.

    t (m,): rising. Short gaps are filled with straight lines. Stamps that wander are replaced by
    those of a clock with a steady rate, which the motion refines (``clock``), unless the samples
    themselves are uneven.
    """
    number = _numbers(t)
    t, notes = _steady(t, number)
    missing = int(number[-1]) + 1 - len(t)
    if not missing:
        return t, a, notes
    step = np.diff(t)
    longest = int(np.argmax(step))
    whole = np.arange(number[-1] + 1)
    filled = np.interp(whole, number, t)
    a = np.column_stack([np.interp(whole, number, values) for values in a.T])
    note = (
        f"{missing} samples ({100.0 * missing / len(whole):.2g} %) are missing; the longest "
        f"gap is {1e3 * step[longest]:.3g} ms at {t[longest]:.6g} s"
    )
    return filled, a, (note, *notes)


def _numbers(t: Array) -> Integers:
    """Return the numbers (n,) of the samples, those that are missing counted."""
    step = np.diff(t)
    wide = step > GAP * np.median(step)
    even = float(step[~wide].mean())  # a median of rounded stamps is rounded, too
    count = np.where(wide, np.rint(step / even), 1.0).astype(np.int64)
    return np.concatenate([[0], np.cumsum(count)])


def _steady(t: Array, number: Integers) -> tuple[Array, tuple[str, ...]]:
    """Return the stamps (n,), or those of a steady clock if they wander around even samples."""
    period = float(t[-1] - t[0]) / float(number[-1])
    size, near = max(round(0.1 / period), 2), 11  # samples of a block; blocks of a parabola
    count = len(t) // size
    # a program that asks a sensor for its value now and then knows best when
    uneven = np.median(np.abs(np.diff(t) / np.diff(number) - period)) > 0.1 * period
    if uneven or count < near:
        return t, ()
    blocks = [v[: count * size].reshape(count, size).mean(axis=1) for v in (number, t - t[0])]
    columns, shown = np.column_stack([blocks[0], np.ones(count)]), blocks[1]
    late = shown - columns @ [period, 0.0]
    if np.median(np.abs(late - savgol_filter(late, near, 2))) < WANDER_S:
        return t, ()
    rate, first = robust_fit(columns, shown).tolist()
    off = 1e3 * float(np.abs(shown - columns @ [rate, first]).max())
    note = (
        f"its time stamps wander by up to {off:.2g} ms; the evenness of its samples is used instead"
    )
    return t[0] + first + rate * number, (note,)


def robust_fit(columns: Array, wanted: Array) -> Array:
    """Return the coefficients (k,) of columns (n, k) that fit most of the values wanted (n,)."""
    weight = np.ones(len(wanted))
    for _ in range(20):
        fit = np.linalg.lstsq(columns * weight[:, None], wanted * weight, rcond=None)[0]
        miss = np.abs(wanted - columns @ fit)
        weight = 1.0 / np.hypot(1.0, miss / (1.5 * np.median(miss) + 1e-9))
    return np.asarray(fit)


GRAVITY = 9806.65  # mm/s²
UNITS = (1.0, 1000.0, GRAVITY)  # mm/s², m/s², g
# of a sensor set to another range than the program believes: 2, 4, 8, 16 g
RANGES = (1.0 / 8.0, 1.0 / 4.0, 1.0 / 2.0, 2.0, 4.0, 8.0)
AXES = "xyz"
PLAUSIBLE = (8000.0, 12000.0)  # of gravity, mm/s²


@dataclass(frozen=True, slots=True)
class Recording:
    """Samples of a sensor: times t (n,) in s, rising and uneven; accelerations a (n, 3) in mm/s².

    started: the first sample follows the start of the command by at most one sample period.
    notes: what was unusual about the file.
    """

    t: Array
    a: Array
    started: bool
    notes: tuple[str, ...] = ()

    @property
    def period(self) -> float:
        """Return the median time between samples in s, on the sensor's own clock."""
        return float(np.median(np.diff(self.t)))

    @property
    def gravity(self) -> float:
        """Return the size of the mean in mm/s²: a motion from rest to rest adds nothing to it."""
        return float(np.linalg.norm(self.a.mean(axis=0)))

    @property
    def up(self) -> Array:
        """Return the unit vector (3,) of gravity's reaction, zero if the mean is not gravity."""
        known = PLAUSIBLE[0] <= self.gravity <= PLAUSIBLE[1]
        return np.asarray(self.a.mean(axis=0) / self.gravity if known else np.zeros(3))

    def warnings(self) -> list[str]:
        """Return what is unusual, for the owner."""
        if self.up.any():
            return list(self.notes)
        return [
            *self.notes,
            f"on average the sensor shows {self.gravity / 1000.0:.4g} m/s² instead of gravity, "
            "9.81 m/s². Its tilt is not removed. Check its unit and range",
        ]


def from_table(path: Path, table: Table) -> Recording:
    """Return the recording in a table of a file, in mm/s², its time stamps repaired.

    Raises IdentificationError, which names file, line and cause.
    """
    _check_samples(path, table)
    a = table.values[:, 1:]
    read = float(np.linalg.norm(a.mean(axis=0)))
    plausible = (u for u in (*UNITS, *RANGES) if PLAUSIBLE[0] <= read * u <= PLAUSIBLE[1])
    unit = next(plausible, 1.0)
    a = a * unit
    _check_clipping(path, table, a)
    t, a, notes = repaired(table.values[:, 0].copy(), a)
    if unit in RANGES:
        shown = f"gravity reads {read / 1000.0:.3g} m/s²"
        notes = (f"{shown}: all values are multiplied by {unit:g}", *notes)
    return Recording(t, a, table.starts_with_command, notes)


# ---------------------------------------------------------------------- checks of samples


def _error(path: Path, table: Table, row: int | None, cause: str) -> IdentificationError:
    name = f"{table.name}: " if table.name else ""
    where = "" if row is None else f"{table.where(row)}: "
    return IdentificationError(f"{path}: {name}{where}{cause}")


def _check_samples(path: Path, table: Table) -> None:
    if (bad := np.flatnonzero(~np.isfinite(table.values).all(axis=1))).size:
        raise _error(path, table, int(bad[0]), "not a finite number")
    t = table.values[:, 0]
    if len(t) < 100:
        raise _error(path, table, None, f"{len(t)} samples are too few; at least 100 are needed")
    # in larger numbers a double no longer resolves microseconds
    if np.abs(t[[0, -1]]).max() > 1e9:
        raise _error(path, table, 0, "timestamps are not in seconds")
    step = np.diff(t)
    if (bad := np.flatnonzero(step <= 0.0)).size:
        raise _error(path, table, int(bad[0]) + 1, "time does not increase")
    period = float(np.median(step))
    if period > 1.0 / 300.0:  # slower sampling cannot show 100 Hz
        cause = f"{1.0 / period:.3g} samples a second are too few; 300 are needed"
        raise _error(path, table, None, f"{cause}. Check that time is in seconds")
    lost = step[step > GAP * period]
    longest, share = lost.max(initial=0.0), lost.sum() / (t[-1] - t[0])
    if longest > verdict.LONGEST_GAP_S or share > verdict.LOST:
        k = int(np.argmax(step))
        cause = f"samples are missing: {step[k]:.4g} s between neighbours at {t[k]:.6g} s"
        share = f"{100.0 * lost.sum() / (t[-1] - t[0]):.2g} % of the recording in all"
        raise _error(path, table, k + 1, f"{cause}, {share}. Record again")


def _check_clipping(path: Path, table: Table, a: Array) -> None:
    for axis, values in zip(AXES, a.T, strict=True):
        at = _clipped(values)
        if at is not None:
            cause = f"acceleration in the sensor's {axis} is clipped at {values[at]:.6g} mm/s²"
            raise _error(
                path, table, at,
                f"{cause}. Record again with a lower acceleration (ACCEL_PER_HZ of TEST_RESONANCES;"
                " for 'measure' limits.acceleration of the profile, with Marlin sweep.amplitude) "
                "or with a greater range of the sensor",
            )  # fmt: skip


def _clipped(values: Array) -> int | None:
    """Return where a signal (n,) first clips: it is at an extreme far more often than near it.

    A slow sine in coarse steps stays at its peak, too, but as long one to three steps below.
    """
    levels = np.unique(values)
    if len(levels) <= 20:  # just noise
        return None
    found: list[int] = []
    for extreme, end in ((levels[0], values <= levels[3]), (levels[-1], values >= levels[-4])):
        at = np.flatnonzero(values == extreme)
        if len(at) >= max(10, 4 * (int(np.count_nonzero(end)) - len(at))):
            found.append(int(at[0]))
    return min(found, default=None)


def axes_map(text: str) -> Array:
    """Return the matrix (3, 3) of axes_map in printer.cfg, such as ``-y, x, z``.

    It may be a reflection: a sensor on a moving bed sees y mirrored, and so do the recordings of
    an owner whose printer.cfg has a wrong sign. Raises IdentificationError if the map is invalid.
    """
    parts = text.lower().replace(" ", "").split(",")
    matrix = np.array([[(p == axis) - float(p == f"-{axis}") for axis in AXES] for p in parts])
    if not np.array_equal(matrix @ matrix.T, np.eye(3)):
        raise IdentificationError(
            f"invalid axes_map {text!r} in printer.cfg: write three axes of the sensor, as in "
            "-y, x, z"
        )
    return matrix
