"""Speed, as ratios to yardsticks of the same run; shown, never asserted in seconds.

make bench
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tests.conftest import SAMPLES


def seconds(*arguments: str) -> float:
    """The best of three runs of a whole process."""
    times = []
    for _ in range(3):
        start = time.perf_counter()
        subprocess.run(arguments, check=True, capture_output=True)
        times.append(time.perf_counter() - start)
    return min(times)


def fastest(benchmark: BenchmarkFixture) -> float:
    """Seconds of the best round."""
    assert benchmark.stats is not None
    return float(benchmark.stats["min"])


@pytest.mark.parametrize("name", ["cube.gcode", "prism.gcode"])
def test_conversion_against_gzip(benchmark: BenchmarkFixture, tmp_path: Path, name: str) -> None:
    out = str(tmp_path / "out.gcode")
    convert = [sys.executable, "-m", "hframe_post", str(SAMPLES / name), "-q", "-o", out]
    benchmark.pedantic(  # type: ignore[no-untyped-call]
        subprocess.run, args=(convert,), kwargs={"check": True}, rounds=3
    )
    gzip = seconds("gzip", "-9", "-k", "-c", out)
    benchmark.extra_info["ratio to gzip -9 of the output"] = fastest(benchmark) / gzip


def test_start_against_numpy(benchmark: BenchmarkFixture) -> None:
    version = [sys.executable, "-m", "hframe_post", "--version"]
    quiet = {"check": True, "capture_output": True}
    benchmark.pedantic(  # type: ignore[no-untyped-call]
        subprocess.run, args=(version,), kwargs=quiet, rounds=5
    )
    numpy = seconds(sys.executable, "-c", "import numpy")
    benchmark.extra_info["ratio to import numpy"] = fastest(benchmark) / numpy
    assert fastest(benchmark) <= 3.0 * numpy
