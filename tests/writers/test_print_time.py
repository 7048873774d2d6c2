"""Lines that tell of print time, and the summary: what is known only at the end, in its place."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from hframe_post.writers.files import Outputs
from hframe_post.writers.stream.print_time import (
    SUMMARY,
    DeferredLine,
    Output,
    commented,
    passed_on,
    with_times,
    write_output,
)


@pytest.mark.parametrize(
    ("line", "elapsed", "printed"),
    [
        (b";TIME:1106", 0.0, b";TIME:2001"),
        (b"; estimated printing time (normal mode) = 1h 2m", 1.0,
         b"; estimated printing time (normal mode) = 33m 20s"),
        (b"M73 P10 R85", 500.0, b"M73 P25 R26"),
        (b"M73 Q10 S85 ; silent", 1000.0, b"M73 Q50 S17 ; silent"),
    ],
)  # fmt: skip
def test_print_times_are_with_times(line: bytes, elapsed: float, printed: bytes) -> None:
    assert with_times(DeferredLine(line, elapsed), 2000.2) == printed


def test_with_timess_are_filled_in_at_their_place(tmp_path: Path) -> None:
    target = tmp_path / "out.gcode"
    with Outputs() as outputs:
        lines: list[Output] = [b"a\n", DeferredLine(b";TIME:9", 0.0), b"b\n"]
        write_output(outputs.open(target), lines, lambda: 123456.0)
    assert [line.rstrip() for line in target.read_bytes().splitlines()] == [
        b"a", b";TIME:123456", b"b",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("line", "printed"),
    [
        (b"; model printing time: 8m 57s; total estimated time: 15m 42s",
         b"; model printing time: 33m 20s; total estimated time: 40m 05s"),
        (b"; estimated printing time (silent mode) = 1d 2h 3m 4s",
         b"; estimated printing time (silent mode) = 33m 20s"),
        (b";Print time: 1:02:03", b";Print time: 0:33:21"),
        (b";Print Time: 3723", b";Print Time: 2001"),
        (b";   Build time: 1 hours 4 minutes", b";   Build time: 0 hours 33 minutes"),
        (b"; Estimated Build Time:   12.34 minutes", b"; Estimated Build Time:   33.34 minutes"),
        (b";estimated_time(s): 4521", b";estimated_time(s): 2001"),
        (b"; --- print time: 1234s ---", b"; --- print time: 2001s ---"),
        (b";PRINT.TIME:1234", b";PRINT.TIME:2001"),
        (b";REMAINING_TIME:1234\r", b";REMAINING_TIME:1001\r"),
        (b"M73 P10.5 R7.5", b"M73 P50 R17"),
        (b"M73 P1 R7 ; P2 R3", b"M73 P50 R17 ; P2 R3"),
        (b"M73 C4 D5 P10 R7", b"M73 C4 D5 P50 R17"),
    ],
)  # fmt: skip
def test_print_times_are_told_in_the_words_of_every_slicer(line: bytes, printed: bytes) -> None:
    deferred = passed_on(line, 1000.0)
    assert isinstance(deferred, DeferredLine)
    assert with_times(deferred, 2000.2) == printed


@pytest.mark.parametrize(
    "line",
    [
        b"; estimated first layer printing time (normal mode) = 1m 2s", b"; time_cost = 0",
        b";TIME: noon", b"M73 L3", b"; printing object 5", b"; Build time", b"M117 ;TIME:5",
        b"SET_PRINT_STATS_INFO CURRENT_LAYER=5", b";LAYER_HEIGHT:0.2", b"; thumbnail begin 16x16 9",
    ],
)  # fmt: skip
def test_what_tells_no_duration_passes_byte_for_byte(line: bytes) -> None:
    assert passed_on(line, 1000.0) == line + b"\n"


def test_the_summary_is_comments_that_fit_their_place() -> None:
    file = io.BytesIO()
    write_output(file, [b"; stamp\n", SUMMARY, b"G1\n"], lambda: 0.0, lambda: "a → b\nWARNING\tc")
    lines = file.getvalue().decode().splitlines()
    assert [line.rstrip() for line in lines] == [
        "; stamp", "; hframe-post: a → b", "; hframe-post: WARNING?c", "G1",
    ]  # fmt: skip
    long = "\n".join(["x" * 100] * 100)
    assert len(commented(long, 1000)) <= 1000
