"""The day of a recording is that of its test, not that of the last copy of its file."""

from __future__ import annotations

import gzip
import os
from collections.abc import Callable
from datetime import UTC, date, datetime
from pathlib import Path

import pytest
import zstandard

from hframe_post.identification.recordings.names import recorded_on

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
    assert recorded_on(file(tmp_path, name)) == day


@pytest.mark.parametrize("pack", [bytes, gzip.compress, zstandard.ZstdCompressor().compress])
@pytest.mark.parametrize(
    "text",
    [
        '{"name": "axis_X_20250526_101500", "samples": [[1, 20200101, 3, 4]]}\n',
        f"# recorded 2025-05-26 10:15\n{ROW}",
        f"Sample 2025-05-26,X,Y,Z\n{ROW}",
    ],
)
def test_then_the_date_in_the_head(
    tmp_path: Path, text: str, pack: Callable[[bytes], bytes]
) -> None:
    assert recorded_on(file(tmp_path, "x.stdata", pack(text.encode()))) == date(2025, 5, 26)


def test_heads_of_packed_files(tmp_path: Path) -> None:
    at = int(datetime(2025, 5, 26, 12, tzinfo=UTC).timestamp())
    packed = gzip.compress((HEAD + ROW).encode(), mtime=at)
    assert recorded_on(file(tmp_path, "x.csv.gz", packed)) == date(2025, 5, 26)
    assert recorded_on(file(tmp_path, "y.csv.gz", packed[:20])) == date(2025, 5, 26)
