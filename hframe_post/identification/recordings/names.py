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
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

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
# by its section's last word, between the axis and a point or the date
NAMED_CHIP = re.compile(r"(?!at_\d)[a-z]\w*?(?=_-?\d+\.\d{3}_|_20\d{6}_\d{6}$)")
WORD = re.compile(r"(?<![a-z0-9])([xyz])(?![a-z0-9])")
NUMBERED = re.compile(r"(?<![a-z0-9])([xyz])(?=\d)")
BELT = re.compile(r"belts?(?:comparison)?(?:[-_].*?)?[-_]([abxz])(?![a-z0-9])")
SHAKETUNE = re.compile(r"shaketune-|inputshaper_|shaper_|resonances_20|axis_")
OTHER_TESTS = {  # tests that excite no band of frequencies
    "a test of the sensor's axes, which the other recordings show as well": re.compile(
        r"axe?s?_?map"
    ),
    "a test at constant speeds, which excites no band of frequencies": re.compile(
        r"(?<![a-z])vib|(?<![a-z])an\d+_\d+sp\d"
    ),
    "a test at a constant frequency, which excites no band of frequencies": re.compile(
        r"static_?freq"
    ),
}
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
EARLIEST = date(2010, 1, 1)  # no accelerometer was recorded on a printer before
BELTS = {"a": (1.0, -1.0, 0.0), "b": (1.0, 1.0, 0.0), "x": (1.0, 0.0, 1.0), "z": (-1.0, 0.0, 1.0)}


@dataclass(frozen=True, slots=True)
class RecordingName:
    """What a name says. Whatever it does not say is None or empty.

    direction: of the motion, a unit vector. point: x and y in mm. chip: of the sensor, words
    joined by ``_``. date: sortable. certain: whether the name is that of a test of resonances.
    other: what the test is, if it shows no resonances. ended: print time in s at which the motion
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
    raw, belt = RAW_DATA.match(name), BELT.search(name)
    words = set(WORD.findall(name)) or set(NUMBERED.findall(name))
    if raw:
        along = AXES[raw["axis"]] if raw["axis"] else _vector(raw["dir"])
    elif belt:
        along = BELTS[belt[1]]
    else:
        along = AXES[words.pop()] if len(words) == 1 else (0.0, 0.0, 0.0)
    length = math.hypot(*along)
    rest = (raw["rest"] or "") if raw else name
    point = (raw and POINT.search(rest)) or PLACE.search(DATE.sub("", rest))
    chip = (raw and NAMED_CHIP.match(rest)) or CHIP.match(rest)
    return RecordingName(
        (along[0] / length, along[1] / length, along[2] / length) if length > 0.0 else None,
        (float(point[1]), float(point[2])) if point else None,
        chip[0].replace("-", "_") if chip else "",
        stamp,
        length > 0.0 and bool(raw or belt or SHAKETUNE.match(name)),
        other,
    )


def day_of(name: RecordingName, path: Path) -> date:
    """Return the day on which a recording was made: that of its name, or of its file.

    A copied or downloaded file has a new time. Raises OSError.
    """
    tomorrow = datetime.now(UTC).date() + timedelta(days=1)  # somewhere it is tomorrow already
    with suppress(ValueError):  # no such day
        if EARLIEST <= (named := date.fromisoformat(name.date[:8])) <= tomorrow:
            return named
    return datetime.fromtimestamp(path.stat().st_mtime, UTC).date()


def _vector(text: str) -> tuple[float, float, float]:
    """Return x, y and z in a text such as 1.000,-1.000 or 1,0,0; zeros if it has no such form."""
    try:
        x, y, z = map(float, (*text.split(","), "0")[:3])
    except ValueError:
        return 0.0, 0.0, 0.0
    return x, y, z
