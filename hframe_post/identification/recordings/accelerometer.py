"""Recordings of accelerometers: samples along the printer's axes, in mm/s².

A sensor at rest shows gravity, upwards, plus its own offset. From gravity follow the unit of a
file, the sensor's tilt, and, from readings with the sensor turned several ways, its gains.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.formats import Table, read_tables
from hframe_post.identification.recordings.packed import unpacked
from hframe_post.identification.recordings.timestamps import GAP, repaired

GRAVITY = 9806.65  # mm/s²
UNITS = (1.0, 1000.0, GRAVITY)  # of other programs: mm/s², m/s², g
# of a sensor set to another range than the program believes: 2, 4, 8, 16 g
RANGES = (1.0, 1.0 / 8.0, 1.0 / 4.0, 1.0 / 2.0, 2.0, 4.0, 8.0)
AXES = "xyz"
FULL_SCALE = 0.999 * 16.0 * GRAVITY  # where common sensors clip
PLAUSIBLE = (8000.0, 12000.0)  # of gravity, mm/s²
LONGEST_GAP, MOST_LOST = 0.1, 0.01  # s, and share of a recording, that may be missing
MANY_LEVELS = 20  # of a signal that is not just noise
OFTEN, OFTEN_THAN_NEAR = 10, 4  # samples at an extreme value; times as many as near it


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


def read(path: str | Path, columns: Sequence[str] | None = None) -> Recording:
    """Return the recording in a file of any known format, which must hold one only.

    columns: names of time (s) and the three accelerations, needed if the file's own do not say
    what they are; with them even a Klipper file is not taken to begin with the command. Raises
    OSError and IdentificationError, which names file, line and cause.
    """
    path = Path(path)
    if columns is not None and len(set(columns)) != 4:
        raise IdentificationError(
            f"{','.join(columns)!r} does not name four columns: time, x, y and z"
        )
    tables = read_tables(path, unpacked(path), columns)
    if len(tables) != 1:
        names = ", ".join(table.name for table in tables[:5]) or "none"
        raise IdentificationError(f"{path} does not hold one recording, but {len(tables)}: {names}")
    return from_table(path, tables[0])


def from_table(path: Path, table: Table) -> Recording:
    """Return the recording in a table of a file, in mm/s², its time stamps repaired.

    Raises IdentificationError, which names file, line and cause.
    """
    _check_samples(path, table)
    a = table.values[:, 1:]
    unit = _by_gravity(a, RANGES if table.in_mm else UNITS)
    a = a * unit
    _check_clipping(path, table, a)
    t, a, notes = repaired(table.values[:, 0].copy(), a)
    if table.in_mm and unit != 1.0:
        read = float(np.linalg.norm(table.values[:, 1:].mean(axis=0))) / 1000.0
        notes = (f"gravity reads {read:.3g} m/s²: all values are multiplied by {unit:g}", *notes)
    return Recording(t, a, table.starts_with_command, notes)


def _by_gravity(a: Array, units: Sequence[float]) -> float:
    """Return the unit, in mm/s², in which the mean of a (n, 3) is gravity; 1 if it is in none."""
    strength = float(np.linalg.norm(a.mean(axis=0)))
    fitting = (unit for unit in units if PLAUSIBLE[0] <= strength * unit <= PLAUSIBLE[1])
    return next(fitting, 1.0)


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
    if lost.max(initial=0.0) > LONGEST_GAP or lost.sum() > MOST_LOST * (t[-1] - t[0]):
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
                f"{cause}. Record again with a lower acceleration (ACCEL_PER_HZ of TEST_RESONANCES,"
                " limits.acceleration of the profile for 'measure', sweep.amplitude for 'sweep') "
                "or with a greater range of the sensor",
            )  # fmt: skip


def _clipped(values: Array) -> int | None:
    """Return where a signal (n,) first clips: it jumps to an extreme value and stays there.

    A slow sine in coarse steps stays at its peak, too, but reaches it by single steps; near its
    rounded peak it jumps by 2.25 steps at most.
    """
    beyond = np.flatnonzero(np.abs(values) >= FULL_SCALE)
    if beyond.size:
        return int(beyond[0])
    levels = np.unique(values)
    if len(levels) < 4:
        return None
    jump = 3.0 * float(np.diff(levels).min())
    found: list[int] = []
    for extreme, end in ((levels[0], values <= levels[3]), (levels[-1], values >= levels[-4])):
        # a slow sensor shows a clipped peak as one sample, but all peaks alike
        at = np.flatnonzero(values == extreme)
        near = int(np.count_nonzero(end)) - len(at)
        if len(levels) > MANY_LEVELS and len(at) >= max(OFTEN, OFTEN_THAN_NEAR * near):
            found.append(int(at[0]))
        first, last = _runs(values == extreme)
        flat = last - first >= 5
        before = np.abs(values[np.maximum(first - 1, 0)] - extreme)
        after = np.abs(values[np.minimum(last, len(values) - 1)] - extreme)
        found += first[flat & (np.maximum(before, after) > jump)].tolist()
    return min(found, default=None)


def _runs(flags: Flags) -> tuple[Integers, Integers]:
    """Return where runs of true flags (n,) begin, and the indices after their ends."""
    edge = np.diff(flags.astype(np.int8), prepend=0, append=0)
    return np.flatnonzero(edge > 0), np.flatnonzero(edge < 0)


# ---------------------------------------------------------------------- axes and gravity


def diagnose(recording: Recording, quiet: float) -> list[str]:
    """Return warnings about a recording as it was read; quiet: s of rest at its start."""
    gravity = float(np.linalg.norm(at_rest(recording, quiet)))
    if PLAUSIBLE[0] <= gravity <= PLAUSIBLE[1]:
        return list(recording.notes)
    return [
        *recording.notes,
        f"at rest the sensor shows {gravity / 1000.0:.4g} m/s² instead of gravity, 9.81 m/s². "
        "Its tilt is not removed. Check its unit, and that the printer stood still at the start",
    ]


def axis_map(axes: str) -> Array:
    """Return the matrix (3, 3) for a map such as ``x=-y,y=x,z=z``.

    It may be a reflection: a sensor on a moving bed sees y mirrored, and so do the recordings of
    an owner whose printer.cfg has a wrong sign. Raises IdentificationError if the map is invalid.
    """
    parts = [re.fullmatch(r"([xyz])=([-+]?)([xyz])", part.strip())
             for part in axes.lower().split(",")]  # fmt: skip
    matrix = np.zeros((3, 3))
    for part in parts:
        if part is not None:
            row, column = AXES.index(part[1]), AXES.index(part[3])
            matrix[row, column] += -1.0 if part[2] == "-" else 1.0
    if None in parts or len(parts) != 3 or not np.array_equal(matrix @ matrix.T, np.eye(3)):
        raise IdentificationError(
            f"invalid axis map {axes!r}: x, y and z must each name one axis of the sensor, as in "
            "x=-y,y=x,z=z"
        )
    return matrix


def at_rest(recording: Recording, quiet: float) -> Array:
    """Return what a sensor shows, (3,), in the first ``quiet`` seconds, in which it is at rest."""
    count = int(np.searchsorted(recording.t, recording.t[0] + quiet))
    return np.asarray(recording.a[: max(count, 1)].mean(axis=0))
