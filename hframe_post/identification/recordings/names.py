"""What the name of a recording says about its test, and when it was made.

    raw_data_x_adxl345_hotend_100.000_110.000_20.000_20250805_220709.csv    Klipper, Kalico
    raw_data_x_hotend_20250805_220709.csv                                   [adxl345 hotend]
    raw_data_axis=1.000,-1.000,0.000_b.csv
    adxl345-hotend-x-at-110.csv                                             ACCELEROMETER_MEASURE
    adxl345-measure-at-110-t123456789.csv                                   _HFRAME_RECORDED
    resonances_20231016_101500_X.csv, belt_20231016_101500_A.csv            Shake&Tune, 2023
    shaketune-axis_X_20240620_101500.csv, inputshaper_20240620_101500_X.csv     2024
    axis_Y_20250805_220709, belt_A_…, axesmap_X_… (within .stdata)              since 2024-12

Any other name may contain x or y as a word, such as ``sv08_x_1.csv``.

A copied or downloaded file has a new time. So the day comes from the file's name (Klipper,
Shake&Tune until 2024), the name of the measurement in it (.stdata), or comments above the first
sample; then from gzip, which keeps the time of the file that it packed; last from the file's time.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.formats import GZIP, unpacked

NUMBER = r"-?\d+(?:\.\d+)?"
ENDINGS = re.compile(r"(\.(csv|txt|stdata|gz|xz|zst))+$", re.IGNORECASE)
ENDED = re.compile(r"-t(\d{4,16})(?![a-z\d])", re.IGNORECASE)  # µs of print time
RAW_DATA = re.compile(
    r"(?:^|.*[^a-z])raw_data_(?:axis=(?P<dir>[-+\d.,]+)|(?P<axis>[xyz]))(?:_(?P<rest>.*))?$"
)
POINT = re.compile(r"(?:^|_)(-?\d+\.\d{3})_(-?\d+\.\d{3})_(-?\d+\.\d{3})(?=_|$)")
PLACE = re.compile(rf"(?<![a-z])at[-_]({NUMBER})[-_]({NUMBER})(?![\d.])")
DATE = re.compile(
    r"(20\d\d)-?([01]\d)-?([0-3]\d)(?:[-_ T]?([0-2]\d)[-.:_]?([0-5]\d)[-.:_]?([0-5]\d))?"
)
CHIP = re.compile(
    r"(?:adxl345|lis2dw12|lis2dw|lis3dh|mpu[-_]?\d+|icm\d+|bmi\d+|bma\d+|beacon|cartographer)"
    r"(?:_(?!at_)[a-z]\w*?(?=_20\d{6}))?"
)
NAMED_CHIP = re.compile(r"(?!at_\d)[a-z]\w*?(?=_20\d{6}_\d{6}$)")  # by the section's last word
WORD = re.compile(r"(?<![a-z0-9])([xyz])(?![a-z0-9])")
NUMBERED = re.compile(r"(?<![a-z0-9])([xyz])(?=\d)")
BELT = re.compile(r"belts?(?:comparison)?(?:[-_].*?)?[-_]([abxz])(?![a-z0-9])")
OTHER_TESTS = {
    "axes map": re.compile(r"axe?s?_?map"),
    "vibrations": re.compile(r"(?<![a-z])vib|(?<![a-z])an\d+_\d+sp\d"),
    "constant frequency": re.compile(r"static_?freq"),
}
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
EARLIEST = date(2010, 1, 1)  # no accelerometer was recorded on a printer before
HEAD = 1 << 12  # bytes in which a date is looked for
SAMPLE = re.compile(r"[-+.\d\s,;]*\d[-+.\deE\s,;]*")  # a line of numbers
JSON_NAME = re.compile(r'"name"\s*:\s*"([^"]*)"')
BELTS = {"a": (1.0, -1.0, 0.0), "b": (1.0, 1.0, 0.0), "x": (1.0, 0.0, 1.0), "z": (-1.0, 0.0, 1.0)}


@dataclass(frozen=True, slots=True)
class RecordingName:
    """What a name says. Whatever it does not say is None or empty.

    direction: of the motion, a unit vector. point: x and y in mm. chip: of the sensor, words
    joined by ``_``. date: sortable. certain: whether the name is that of a test of resonances.
    other: the kind of a test that shows no resonances. ended: print time in s at which the motion
    had ended.
    """

    direction: tuple[float, float, float] | None = None
    point: tuple[float, float] | None = None
    chip: str = ""
    date: str = ""
    certain: bool = False
    other: str = ""
    ended: float | None = None

    def __or__(self, known: RecordingName) -> RecordingName:
        """Return this with what it does not say taken from another name."""
        return RecordingName(
            self.direction or known.direction, self.point or known.point, self.chip or known.chip,
            self.date or known.date, self.certain or known.certain, self.other or known.other,
            known.ended if self.ended is None else self.ended,
        )  # fmt: skip


def stem(name: str) -> str:
    """Return a file's name without its endings and without the print time in it."""
    return ENDED.sub("", ENDINGS.sub("", name))


def parsed(name: str) -> RecordingName:
    """Return what the name of a file, or of a measurement in it, says about its test."""
    if times := ENDED.findall(name):
        return replace(parsed(ENDED.sub("", name)), ended=1e-6 * int(times[-1]))
    name = ENDINGS.sub("", name.lower())
    stamps = ["".join(filter(None, found.groups())) for found in DATE.finditer(name)]
    stamp = stamps[-1] if stamps else ""
    other = next((kind for kind, form in OTHER_TESTS.items() if form.search(name)), "")
    if found := RAW_DATA.match(name):
        rest = found["rest"] or ""
        point = POINT.search(rest)
        direction = AXES[found["axis"]] if found["axis"] else _direction(found["dir"])
        named = NAMED_CHIP.match(rest)
        chip = rest[: point.start()] if point else named[0] if named else _chip(rest)
        place = (float(point[1]), float(point[2])) if point else _place(rest)
        return RecordingName(direction, place, chip, stamp, direction is not None, other)
    shaketune = re.match(r"(shaketune-|inputshaper_|shaper_|resonances_20|axis_)", name) is not None
    if found := BELT.search(name):
        return RecordingName(_unit(BELTS[found[1]]), _place(name), _chip(name), stamp, True, other)
    words = set(WORD.findall(name)) or set(NUMBERED.findall(name))
    axis = AXES[words.pop()] if len(words) == 1 else None
    return RecordingName(
        axis, _place(name), _chip(name), stamp, shaketune and axis is not None, other
    )


# ---------------------------------------------------------------------- day


def recorded_on(path: Path) -> date:
    """Return the day on which the recording in a file was made. Raises OSError."""
    written = datetime.fromtimestamp(path.stat().st_mtime, UTC).date()
    tomorrow = datetime.now(UTC).date() + timedelta(days=1)  # somewhere it is tomorrow already
    named = (*days_in(path.name), *_days_in_head(path))
    return next((day for day in named if EARLIEST <= day <= tomorrow), written)


def days_in(text: str) -> list[date]:
    """Return the days that a name or a line names, the last first."""
    found = []
    for year, month, day, *_ in DATE.findall(ENDED.sub("", text)):
        with suppress(ValueError):  # no such day
            found.append(date(int(year), int(month), int(day)))
    return found[::-1]


def _days_in_head(path: Path) -> Iterator[date]:
    try:
        text = unpacked(path)[:HEAD].decode("latin-1")
    except IdentificationError:  # damaged
        text = ""
    if text.startswith("{"):
        text = "\n".join(JSON_NAME.findall(text))
    for line in text.splitlines():
        if SAMPLE.fullmatch(line):
            break
        yield from days_in(line)
    with path.open("rb") as file:
        start = file.read(8)
    if start.startswith(GZIP) and (packed := int.from_bytes(start[4:8], "little")):
        yield datetime.fromtimestamp(packed, UTC).date()


# ---------------------------------------------------------------------- parts of names


def _direction(text: str) -> tuple[float, float, float] | None:
    try:
        x, y, *z = (float(part) for part in text.split(","))
    except ValueError:
        return None
    return _unit((x, y, z[0] if z else 0.0)) if len(z) < 2 else None


def _unit(vector: tuple[float, float, float]) -> tuple[float, float, float] | None:
    length = math.hypot(*vector)
    x, y, z = vector
    return (x / length, y / length, z / length) if length > 0.0 else None


def _chip(text: str) -> str:
    found = CHIP.match(text)
    return found[0].replace("-", "_") if found else ""


def _place(text: str) -> tuple[float, float] | None:
    """Return the place in a name such as ``at_110_150`` or ``x-at-110-150``."""
    found = PLACE.search(DATE.sub("", text))
    return (float(found[1]), float(found[2])) if found else None
