"""Durations of processes and of benchmarks."""

from __future__ import annotations

import subprocess
import time

from pytest_benchmark.fixture import BenchmarkFixture


def seconds(*arguments: str, rounds: int = 3) -> float:
    """The best of some runs of a whole process."""
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        subprocess.run(arguments, check=True, capture_output=True)
        times.append(time.perf_counter() - start)
    return min(times)


def fastest(benchmark: BenchmarkFixture) -> float:
    """Seconds of the best round."""
    assert benchmark.stats is not None
    return float(benchmark.stats["min"])
