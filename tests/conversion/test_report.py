"""Running statistics, and output files that are whole or not there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hframe_post.prediction.statistics import ErrorStatistics
from hframe_post.writers.atomic_file import Outputs
from hframe_post.writers.deferred import DeferredLine, Output
from hframe_post.writers.print_time import duration, told_anew, write_output


def test_statistics_are_those_of_the_whole_stream() -> None:
    errors = np.random.default_rng(0).lognormal(-6, 1, 50_000)
    statistics = ErrorStatistics()
    for piece in np.array_split(errors, 37):
        statistics.add(piece)
    assert statistics.rms == pytest.approx(np.sqrt((errors**2).mean()))
    assert statistics.peak == errors.max()
    assert statistics.percentile(0.95) == pytest.approx(np.quantile(errors, 0.95), rel=0.02)


def test_statistics_of_nothing_are_zero() -> None:
    assert ErrorStatistics().micrometres() == {"rms": 0.0, "p95": 0.0, "peak": 0.0}


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0m 00s"), (75, "1m 15s"), (3600, "1h 00m 00s")]
)
def test_duration(seconds: float, text: str) -> None:
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ("line", "elapsed", "told"),
    [
        (b";TIME:1106", 0.0, b";TIME:2001"),
        (b"; estimated printing time (normal mode) = 1h 2m", 1.0,
         b"; estimated printing time (normal mode) = 33m 20s"),
        (b"M73 P10 R85", 500.0, b"M73 P25 R26"),
        (b"M73 Q10 S85 ; silent", 1000.0, b"M73 Q50 S17 ; silent"),
    ],
)  # fmt: skip
def test_print_times_are_told_anew(line: bytes, elapsed: float, told: bytes) -> None:
    assert told_anew(DeferredLine(line, elapsed), 2000.2) == told


def test_told_anews_are_filled_in_at_their_place(tmp_path: Path) -> None:
    target = tmp_path / "out.gcode"
    with Outputs() as outputs:
        lines: list[Output] = [b"a\n", DeferredLine(b";TIME:9", 0.0), b"b\n"]
        write_output(outputs.open(target), lines, lambda: 123456.0)
    assert [line.rstrip() for line in target.read_bytes().splitlines()] == [
        b"a", b";TIME:123456", b"b",
    ]  # fmt: skip
