"""The day of a recording is that of its test, not that of the last copy of its file."""

import json
import os
from datetime import UTC, date, datetime
from pathlib import Path

import pytest
import zstandard

from hframe_post.identification.recordings.folder import contents
from hframe_post.identification.recordings.names import day_of, parsed

COPIED = date(2026, 2, 3)
HEAD = "#time,accel_x,accel_y,accel_z\n"
ROW = "1.0,20200101.0,3.0,9800.0\n"


def file(folder: Path, name: str, content: bytes = (HEAD + ROW).encode()) -> Path:
    path = folder / name
    path.write_bytes(content)
    at = datetime(COPIED.year, COPIED.month, COPIED.day, 12, tzinfo=UTC).timestamp()
    os.utime(path, (at, at))
    return path


@pytest.mark.parametrize(
    ("name", "day"),
    [
        ("raw_data_x_20250526_101500.csv", date(2025, 5, 26)),
        ("raw_data_x_adxl345_100.000_110.000_20.000_20250526_101500.csv", date(2025, 5, 26)),
        ("0_2025-05-26_10.15.00.csv", date(2025, 5, 26)),
        ("20240101_backup_of_raw_data_x_20250526_101500.csv", date(2025, 5, 26)),
        ("raw_data_x_20251345_101500.csv", COPIED),  # no such day
        ("raw_data_x_20980526_101500.csv", COPIED),  # a clock that was wrong
        ("raw_data_x_1.csv", COPIED),
    ],
)
def test_the_date_in_the_name_counts_first(tmp_path: Path, name: str, day: date) -> None:
    assert day_of(parsed(name), file(tmp_path, name)) == day


def test_then_the_date_of_the_measurement_in_the_file(tmp_path: Path) -> None:
    rows = [[k / 800.0, float(k % 7), 3.0, 9800.0] for k in range(200)]
    text = json.dumps({"name": "axis_X_20250526_101500", "samples": rows}) + "\n"
    path = file(tmp_path, "x.stdata", zstandard.ZstdCompressor().compress(text.encode()))
    ((found,), _) = contents([path])
    assert found.day == date(2025, 5, 26)
