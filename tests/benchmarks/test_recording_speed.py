"""Speed of accelerometer files, as ratios to numpy reading the same numbers in the same run.

make bench
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from pytest_benchmark.fixture import BenchmarkFixture

from hframe_post.identification.recordings.accelerometer import read
from tests.benchmarks.timing import fastest
from tests.recordings import Sensor, spline, sweep, write_klipper


def written(folder: Path) -> Path:
    """Two minutes of Klipper's samples."""
    swept = sweep(rate=1.0)
    recording = Sensor(drift=0.005).record(spline(0.0 * swept, swept), (len(swept) - 1) / 1000.0)
    return write_klipper(folder / "raw.csv", recording)


def numpy_seconds(path: Path) -> float:
    took = []
    for _ in range(3):
        start = time.perf_counter()
        np.loadtxt(path, delimiter=",", skiprows=1)
        took.append(time.perf_counter() - start)
    return min(took)


def test_reading_against_numpy(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    path = written(tmp_path)
    benchmark.pedantic(read, args=(path,), rounds=3)  # type: ignore[no-untyped-call]
    assert fastest(benchmark) < 3.0 * numpy_seconds(path)
