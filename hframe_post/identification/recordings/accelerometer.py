"""Recordings of accelerometers: Klipper's files and others → m samples along the printer's axes.

A sensor at rest shows gravity, upwards, with its own offset. Klipper keeps the samples whose
times lie between the two calls of ``ACCELEROMETER_MEASURE``, so its file begins with the command.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.number_table import read_table

GRAVITY = 9806.65  # mm/s²
UNITS = {"mm/s2": 1.0, "m/s2": 1000.0, "g": GRAVITY}
KLIPPER = ("#time", "accel_x", "accel_y", "accel_z")
DELIMITERS = ",;\t"
AXES = "xyz"
LONGEST_CAUSE = 200  # characters of what a library says of a broken file
LONGEST_NAME = 40  # of a column, as errors show it

FEWEST = 100  # samples from which anything can be told
SLOWEST = 300.0  # samples a second below which 100 Hz cannot be told
MOST_LOST = 5.0  # sample periods between neighbours
LONGEST_SECONDS = 1e9  # of a clock; further on, a double no longer tells microseconds
FULL_SCALE = 0.999 * 16.0 * GRAVITY  # where common sensors end
FLAT = 5  # equal samples at an extreme value that make it clipping, if there was a jump to it
EDGE = 3.0  # of so many of the sensor's steps: the rounded peak of a sine jumps by 2.25 at most
PLAUSIBLE = (8000.0, 12000.0)  # of gravity, mm/s²
STEEPEST = 45.0  # degrees of tilt beyond which the axis map must be wrong

_MAP = re.compile(r"([xyz])=([-+]?)([xyz])")


@dataclass(frozen=True, slots=True)
class Recording:
    """Acceleration as a sensor tells it.

    t (n,): s, rising, as irregular as recorded; a (n, 3): mm/s². started: the first sample
    follows the start of the command by no more than a sample period.
    """

    t: Array
    a: Array
    started: bool

    @property
    def period(self) -> float:
        """Seconds from one sample to the next, on its own clock; the median."""
        return float(np.median(np.diff(self.t)))


def read(path: str | Path, columns: Sequence[str] | None = None, unit: str = "mm/s2") -> Recording:
    """The recording in a file: .npz, .mat, or text with a line of names first.

    columns: names of time (s) and the three accelerations, in ``unit`` (of UNITS). Without them
    the file must be Klipper's, which is always in mm/s²; with them a file of Klipper's is not
    taken to begin with the command. Raises OSError and IdentificationError, which names file,
    line and cause.
    """
    path = Path(path)
    if unit not in UNITS:
        raise IdentificationError(f"{unit!r} is none of the units {', '.join(UNITS)}")
    if columns is not None and len(set(columns)) != len(KLIPPER):
        raise IdentificationError(
            f"{','.join(columns)!r} does not name four columns: time, x, y and z"
        )
    if path.suffix in (".npz", ".mat"):
        arrays = _npz(path) if path.suffix == ".npz" else _mat(path)
        table = _Table(path, _chosen(path, arrays, columns), None)
        started = False
    else:
        text = path.read_bytes()
        table = _csv(path, text, columns)
        started = columns is None
    scale = 1.0 if started else UNITS[unit]
    table.check()
    a = table.values[:, 1:] * scale
    table.check_clipping(a)
    return Recording(table.values[:, 0].copy(), a, started)


@dataclass(frozen=True, slots=True)
class _Table:
    """Rows of time and three accelerations, (n, 4), and the text they come from, if any."""

    path: Path
    values: Array
    text: bytes | None

    def check(self) -> None:
        """Raises IdentificationError where these are no samples of a sensor."""
        if (bad := np.flatnonzero(~np.isfinite(self.values).all(axis=1))).size:
            raise self.wrong("not a finite number", int(bad[0]))
        t = self.values[:, 0]
        if len(t) < FEWEST:
            raise self.wrong(f"{len(t)} samples are too few, {FEWEST} at least are needed")
        if np.abs(t[[0, -1]]).max() > LONGEST_SECONDS:
            raise self.wrong("the times are no seconds", 0)
        step = np.diff(t)
        if (bad := np.flatnonzero(step <= 0.0)).size:
            raise self.wrong("time does not go forwards", int(bad[0]) + 1)
        period = float(np.median(step))
        if period > 1.0 / SLOWEST:
            cause = f"{1.0 / period:.3g} samples a second are too few, {SLOWEST:g} are needed"
            raise self.wrong(cause + "; is time in seconds?")
        if (bad := np.flatnonzero(step > MOST_LOST * period)).size:
            k = int(bad[0])
            cause = f"samples are missing: {step[k]:.4g} s between neighbours at {t[k]:.6g} s"
            raise self.wrong(f"{cause}, {period:.3g} s elsewhere; record again", k + 1)

    def check_clipping(self, a: Array) -> None:
        """The same where a (n, 3), mm/s², reached the end of what the sensor can show."""
        for axis, values in zip(AXES, a.T, strict=True):
            at = _clipped(values)
            if at is not None:
                cause = f"acceleration in the sensor's {axis} is clipped at {values[at]:.6g} mm/s²"
                raise self.wrong(cause + "; lower the sweep's amplitude and record again", at)

    def wrong(self, cause: str, row: int | None = None) -> IdentificationError:
        """The error, with where it is."""
        if row is None:
            where = ""
        elif self.text is None:
            where = f"sample {row + 1}: "
        else:
            lines = self.text.splitlines()
            full = [number for number, line in enumerate(lines, 1) if line.strip()]
            where = f"line {full[row + 1]}: "
        return IdentificationError(f"{self.path}: {where}{cause}")


def _clipped(values: Array) -> int | None:
    """Where a signal (n,) first stays at its greatest or least value as only clipping does.

    Quantised, a slow sine stays there too, but comes to it by single steps.
    """
    beyond = np.flatnonzero(np.abs(values) >= FULL_SCALE)
    if beyond.size:
        return int(beyond[0])
    levels = np.unique(values)
    if len(levels) < 3:
        return None
    jump = EDGE * float(np.diff(levels).min())
    found = []
    for extreme in (levels[0], levels[-1]):
        first, last = _runs(values == extreme)
        flat = last - first >= FLAT
        before = np.abs(values[np.maximum(first - 1, 0)] - extreme)
        after = np.abs(values[np.minimum(last, len(values) - 1)] - extreme)
        found += first[flat & (np.maximum(before, after) > jump)].tolist()
    return min(found, default=None)


def _runs(flags: Any) -> tuple[Integers, Integers]:
    """First indices of runs of true flags (n,), and those after their ends."""
    edge = np.diff(flags.astype(np.int8), prepend=0, append=0)
    return np.flatnonzero(edge > 0), np.flatnonzero(edge < 0)


# ---------------------------------------------------------------------- files


def _csv(path: Path, text: bytes, columns: Sequence[str] | None) -> _Table:
    """Text with one line of names and then numbers."""
    first, _, _ = text.lstrip().partition(b"\n")
    if not first:
        raise IdentificationError(f"{path}: the file is empty")
    head = first.decode("utf-8-sig", "replace").strip()
    delimiter = max(DELIMITERS, key=head.count)
    names = [name.strip().strip("\"'") for name in head.split(delimiter)]
    if "psd_xyz" in names:
        raise IdentificationError(
            f"{path}: line 1: this is a spectrum that Klipper has computed, not a recording: take "
            "the file that ACCELEROMETER_MEASURE wrote, which begins with #time"
        )
    if columns is None and tuple(names) != KLIPPER:
        raise IdentificationError(
            f"{path}: line 1: this is no accelerometer file of Klipper's; "
            f"say which columns hold time and x, y, z; {_there(names)}"
        )
    places = [_place(path, names, name) for name in columns or KLIPPER]
    try:
        if b"\n" not in text.strip():
            values = np.zeros((0, 4))
        else:
            values = read_table(
                io.BytesIO(text), delimiter=delimiter, skiprows=_before(text), usecols=places,
                encoding="latin-1",
            )  # fmt: skip
    except ValueError:
        raise _bad_line(path, text, delimiter, places) from None
    return _Table(path, values, text)


def _before(text: bytes) -> int:
    """Lines up to that of the names."""
    return text[: len(text) - len(text.lstrip())].count(b"\n") + 1


def _bad_line(
    path: Path, text: bytes, delimiter: str, places: Sequence[int]
) -> IdentificationError:
    """The error of the first line that holds no numbers."""
    lines = text.splitlines()
    for number, line in enumerate(lines[_before(text) :], _before(text) + 1):
        parts = line.decode("latin-1").split(delimiter)
        if not line.strip():
            continue
        shown = repr(line.strip()[:LONGEST_NAME].decode("latin-1"))
        if len(parts) <= max(places):
            last = " (the file is cut off?)" if number == len(lines) else ""
            return IdentificationError(f"{path}: line {number}: too few columns: {shown}{last}")
        try:
            [float(parts[place]) for place in places]
        except ValueError:
            return IdentificationError(f"{path}: line {number}: this is no number: {shown}")
    return IdentificationError(f"{path}: this cannot be read as numbers")


def _npz(path: Path) -> Mapping[str, Any]:
    content = io.BytesIO(path.read_bytes())
    try:
        with np.load(content, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except Exception as error:  # a broken file fails in many ways
        cause = str(error)[:LONGEST_CAUSE]
        raise IdentificationError(f"{path}: this cannot be read as .npz: {cause}") from None


def _mat(path: Path) -> Mapping[str, Any]:
    from scipy.io import loadmat

    content = io.BytesIO(path.read_bytes())
    try:
        found = loadmat(content)
    except NotImplementedError:
        cause = "MATLAB 7.3 files cannot be read; save with -v7"
        raise IdentificationError(f"{path}: {cause}") from None
    except Exception as error:  # as above
        cause = str(error)[:LONGEST_CAUSE]
        raise IdentificationError(f"{path}: this cannot be read as .mat: {cause}") from None
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _chosen(path: Path, arrays: Mapping[str, Any], columns: Sequence[str] | None) -> Array:
    """The four named arrays side by side, (n, 4)."""
    if columns is None:
        raise IdentificationError(
            f"{path}: say which arrays hold time and x, y, z; {_there(list(arrays))}"
        )
    chosen = []
    for name in columns:
        _place(path, list(arrays), name)
        array = np.squeeze(np.asarray(arrays[name]))
        if array.ndim != 1 or array.dtype.kind not in "fiu":
            raise IdentificationError(f"{path}: {name} is no list of real numbers")
        chosen.append(array.astype(np.float64))
    if len({len(array) for array in chosen}) > 1:
        sizes = ", ".join(f"{n}: {len(a)}" for n, a in zip(columns, chosen, strict=True))
        raise IdentificationError(f"{path}: the arrays differ in length ({sizes})")
    return np.column_stack(chosen)


def _place(path: Path, names: list[str], name: str) -> int:
    if names.count(name) != 1:
        cause = f"there is no column {name}" if name not in names else f"{name} occurs twice"
        raise IdentificationError(f"{path}: {cause}; {_there(names)}")
    return names.index(name)


def _there(names: list[str]) -> str:
    return "there are: " + ", ".join(name[:LONGEST_NAME] for name in names[:10])


# ----------------------------------------------------------------------- axes


def diagnose(recording: Recording, quiet: float) -> list[str]:
    """Warnings in words about a recording as it was read; quiet: s of rest at its start."""
    gravity = float(np.linalg.norm(_at_rest(recording, quiet)))
    if PLAUSIBLE[0] <= gravity <= PLAUSIBLE[1]:
        return []
    return [
        f"at rest the sensor shows {gravity / 1000.0:.4g} m/s², not gravity's 9.81: is the unit "
        "wrong? Its tilt is not removed"
    ]


def oriented(recording: Recording, axes: str = "x=x,y=y,z=z", quiet: float = 1.0) -> Recording:
    """The recording along the printer's axes, without gravity, tilt and offset.

    axes: each axis of the printer as the sensor names it, such as ``x=-y,y=x,z=z``. Tilt is
    how gravity lies in the first ``quiet`` seconds, in which the printer must stand; where the
    sensor shows none (``diagnose``) only the map and the offset count. A turn about the vertical
    stays: see ``alignment.heading``. Raises IdentificationError.
    """
    matrix = axis_map(axes)
    rest = matrix @ _at_rest(recording, quiet)
    strength = float(np.linalg.norm(rest))
    turn = np.eye(3)
    if PLAUSIBLE[0] <= strength <= PLAUSIBLE[1]:
        tilt = np.degrees(np.arccos(np.clip(rest[2] / strength, -1.0, 1.0)))
        if tilt > STEEPEST:
            raise IdentificationError(
                f"by the axis map {axes} the sensor is tilted by {tilt:.0f}°: z must name the "
                "sensor's axis that points up"
            )
        turn = _upright(rest / strength)
    a = recording.a @ (turn @ matrix).T
    return replace(recording, a=a - turn @ rest)


def axis_map(axes: str) -> Array:
    """The rotation (3, 3) that a map such as ``x=-y,y=x,z=z`` stands for.

    Raises IdentificationError for what is none.
    """
    parts = [_MAP.fullmatch(part.strip()) for part in axes.lower().split(",")]
    matrix = np.zeros((3, 3))
    for part in parts:
        if part is not None:
            row, column = AXES.index(part[1]), AXES.index(part[3])
            matrix[row, column] += -1.0 if part[2] == "-" else 1.0
    if None in parts or len(parts) != 3 or not np.array_equal(matrix @ matrix.T, np.eye(3)):
        raise IdentificationError(
            f"{axes!r} is no axis map: x, y and z must each name one axis of the sensor, as in "
            "x=-y,y=x,z=z"
        )
    if np.linalg.det(matrix) < 0.0:
        raise IdentificationError(
            f"the axis map {axes} is left-handed, which no sensor can be: a sign is wrong or two "
            "axes are exchanged"
        )
    return matrix


def _at_rest(recording: Recording, quiet: float) -> Array:
    """What the sensor shows in its first ``quiet`` seconds, (3,)."""
    count = int(np.searchsorted(recording.t, recording.t[0] + quiet))
    return np.asarray(recording.a[: max(count, 1)].mean(axis=0))


def _upright(up: Array) -> Array:
    """The shortest rotation (3, 3) that takes the unit vector ``up`` (3,) to z; up_z > −1."""
    x, y, z = up
    k = 1.0 / (1.0 + z)
    return np.array([[1.0 - k * x * x, -k * x * y, -x], [-k * x * y, 1.0 - k * y * y, -y], up])
