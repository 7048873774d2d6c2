"""Durations of processes and of benchmarks."""

from __future__ import annotations

import os
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


def processor_and_wall(*arguments: str) -> tuple[float, float]:
    """Return the processor time of a process with its children, and its duration, both in s."""
    start = time.perf_counter()
    process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - start
    assert process.returncode == 0
    return used.ru_utime + used.ru_stime, wall


def fastest(benchmark: BenchmarkFixture) -> float:
    """Seconds of the best round."""
    assert benchmark.stats is not None
    return float(benchmark.stats["min"])
