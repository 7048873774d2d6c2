"""Lines that tell of print time, the summary, and previews, which stay in the first bytes."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hframe_post as hp
from hframe_post.writers.outputs import Outputs
from hframe_post.writers.print_time import (
    SUMMARY,
    Deferred,
    Output,
    after_head,
    commented,
    later,
    says_time,
    times_of,
    with_times,
    write_output,
)


@pytest.mark.parametrize(
    ("line", "printed"),
    [
        # 1000 s as sliced and 1100 s as converted, a fourth of which has passed
        (b";TIME:1106", b";TIME:1206"),
        (b";TIME:1106.25", b";TIME:1206.25"),
        (b";TIME_ELAPSED:81.295931", b";TIME_ELAPSED:106.295931"),
        (b";REMAINING_TIME:1234\r", b";REMAINING_TIME:1309\r"),
        (b";PRINT.TIME:999", b";PRINT.TIME:1099"),
        (b";Print Time: 3723", b";Print Time: 3823"),
        (b";Print time: 1:02:03", b";Print time: 1:03:43"),
        (b"; Build Time: 00:59:30", b"; Build Time: 01:01:10"),
        (b"; print time: 16:40", b"; print time: 18:20"),
        (b"; print time: 16h:40m", b"; print time: 16h:42m"),
        (b"; Print time: 13m:37s", b"; Print time: 15m:17s"),
        (b";   Build time: 1 hours 4 minutes", b";   Build time: 1 hours 6 minutes"),
        (b";   Build time: 1 hour and 59 min", b";   Build time: 2 hour and 1 min"),
        (b"; Estimated Build Time:   12.34 minutes", b"; Estimated Build Time:   14.01 minutes"),
        (b"; Calculated-during-export Build Time: 9.50 minutes",
         b"; Calculated-during-export Build Time: 11.17 minutes"),
        (b";estimated_time(s): 4521", b";estimated_time(s): 4621"),
        (b"; estimated_print_time_s :    12.5", b"; estimated_print_time_s :    112.5"),
        (b"; --- print time: 1234s ---", b"; --- print time: 1334s ---"),
        (b"; estimated printing time (normal mode) = 8m 30s",
         b"; estimated printing time (normal mode) = 10m 10s"),
        (b"; estimated printing time (silent mode) = 1d 2h 3m 4s",
         b"; estimated printing time (silent mode) = 1d 2h 4m 44s"),
        (b"; estimated printing time (normal mode) = 1h 58m 30s",
         b"; estimated printing time (normal mode) = 2h 0m 10s"),
        (b"; Estimated printing time = 1h 02m 03s", b"; Estimated printing time = 1h 03m 43s"),
        (b"; model printing time: 8m 57s; total estimated time: 15m 42s",
         b"; model printing time: 10m 37s; total estimated time: 17m 22s"),
        (b"M73 P10 R85", b"M73 P10 R86"), (b"M73 Q10 S85 ; silent", b"M73 Q10 S86 ; silent"),
        (b"M73 P10.5 R7.5", b"M73 P10.5 R8.8"), (b"M73 C4 D5 P10 R7", b"M73 C4 D5 P10 R8"),
        (b"M73 P1 R7 ; P2 R3", b"M73 P1 R8 ; P2 R3"),
        (b"M117 Time Left 1h2m3s", b"M117 Time Left 1h3m18s"),
    ],
)  # fmt: skip
def test_times_change_as_the_print_and_keep_form(line: bytes, printed: bytes) -> None:
    """What only the slicer knows of, such as 62 changes of filament, stays in them."""
    assert says_time(line)
    assert with_times(line, 275.0, 1000.0, 1100.0) == printed
    assert with_times(line, 275.0, 1000.0, 1000.0) == line
    file = io.BytesIO()
    lines = [later(Deferred.from_line(line, 200.0), 75.0)]
    write_output(file, lines, lambda: (1000.0, 1100.0))
    assert file.getvalue().rstrip() == printed.rstrip()


@pytest.mark.parametrize("after", [700.0, 1000.0, 1234.5])
def test_lines_of_progress_are_written_as_one_by_one(after: float) -> None:
    """The loop for M73 in its usual form, and the lines that it leaves."""
    rng = np.random.default_rng(4)
    forms = b"M73 P%d R%d|M73 Q%d S%d|M73 P%d R%d ; left|M73 P%d R%d.5|M73 P%d R0%d".split(b"|")
    lines = [forms[k % 5] % tuple(rng.integers(0, 100, 2)) for k in range(500)]
    elapsed = rng.uniform(0.0, after, len(lines))
    file = io.BytesIO()
    pieces = [Deferred.from_line(*each) for each in zip(lines, elapsed.tolist(), strict=True)]
    write_output(file, pieces, lambda: (1000.0, after))
    for line, at, text in zip(lines, elapsed, file.getvalue().splitlines(), strict=True):
        assert text.rstrip(b" ") == with_times(line, float(at), 1000.0, after)


def test_times_of_modes_are_told_apart_by_their_letter() -> None:
    assert times_of(b"M73 P10 R85 ; S3") == {"R": 5100.0}
    assert times_of(b"M73 Q10 S60") == {"S": 3600.0}


def test_at_the_end_nothing_is_left_and_a_faster_print_takes_some_time() -> None:
    assert with_times(b"M73 P100 R0", 1100.0, 1000.0, 1100.0) == b"M73 P100 R0"
    faster = with_times(b";TIME:100", 0.0, 1000.0, 600.0)
    assert faster == b";TIME:60"  # the slicer expects a tenth of what the firmware takes
    assert with_times(b";TIME:100", 0.0, 0.0, 0.0) == b";TIME:100"


def test_times_are_filled_in_at_their_place(tmp_path: Path) -> None:
    target = tmp_path / "out.gcode"
    with Outputs() as outputs:
        lines: list[Output] = [b"a\n", Deferred.from_line(b";TIME:9", 0.0), b"b\n"]
        write_output(outputs.open(target), lines, lambda: (7.0, 98.0))
    assert [line.rstrip() for line in target.read_bytes().splitlines()] == [
        b"a", b";TIME:100", b"b",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "line",
    [
        b"; estimated first layer printing time (normal mode) = 1m 2s", b"; time_cost = 0",
        b";TIME: noon", b"M73 L3", b"; printing object 5", b"; Build time", b"M117 ;TIME:5",
        b"SET_PRINT_STATS_INFO CURRENT_LAYER=5", b";LAYER_HEIGHT:0.2", b"; thumbnail begin 16x16 9",
        b"; filament_load_time = 120,120", b"; slow_down_layer_time = 5", b"; remaining_times = 1",
        b"M73 P5",
    ],
)  # fmt: skip
def test_what_tells_no_duration_passes_byte_for_byte(line: bytes) -> None:
    assert not says_time(line)


def test_the_summary_is_comments_that_fit_their_place() -> None:
    file = io.BytesIO()
    pieces: list[Output] = [b"; stamp\n", SUMMARY, b"G1\n"]
    write_output(file, pieces, lambda: (0.0, 0.0), lambda: "a → b\nWARNING\tc")
    lines = file.getvalue().decode().splitlines()
    assert [line.rstrip() for line in lines] == [
        "; stamp", "; hframe-post: a → b", "; hframe-post: WARNING?c", "G1",
    ]  # fmt: skip
    long = "\n".join(["x" * 100] * 100)
    assert len(commented(long, 1000)) <= 1000


HEX = b"08410841084108410841"
HEADS = {
    "MKS": b";simage:%b\nM10086 ;%b\n;;gimage:%b\nM10086 ;%b\n" % (HEX, HEX, HEX, HEX),
    "BTT": b";0046004600000000\r\n;%b\r\n; bigtree thumbnail end\r\n\r\n" % HEX,
    "Creality": b"; jpg begin 300x300 9 3 197 500\n; /9j/4AAQSkZJRgAB\n; jpg end\n;\n\n",
    "Prusa": b"; generated by PrusaSlicer 2.9.2\n\n;\n; thumbnail_QOI begin 16x16 8\n; cW9pZgAA\n",
    "Anycubic": b"\xef\xbb\xbf;thumbnail begin 230x110 4\n; iVBO\n;thumbnail end\n",
    "Elegoo": b";gimage:%b\r\n;simage:%b\r\n\r\r;end_of_preview\r\n" % (HEX, HEX),
}


@pytest.mark.parametrize("screen", HEADS)
@pytest.mark.parametrize("lines", [True, False])
def test_previews_stay_in_the_first_bytes(screen: str, lines: bool) -> None:
    """MKS reads 512 bytes and looks for ';simage:'; BTT seeks a fixed place."""
    head = HEADS[screen].removeprefix(b"\xef\xbb\xbf")
    whole = head + b"G28\n;later\n"
    rows = [row + b"\n" for row in whole.split(b"\n")[:-1]] if lines else [whole]
    out = after_head(rows, b"; stamp\n", SUMMARY)
    text = b"".join(piece for piece in out if isinstance(piece, bytes))
    assert text.startswith(head + b"; stamp\nG28\n")


def test_times_in_the_head_and_a_file_of_comments() -> None:
    time = Deferred.from_line(b";TIME:5", 0.0)
    assert list(after_head([b";a\n", time, b"G28\n"], b"x")) == [b";a\n", time, b"x", b"G28\n"]
    percent = Deferred.from_line(b"M73 P0 R5", 0.0)
    assert list(after_head([b";a\n", percent], b"x")) == [b";a\n", b"x", percent]
    assert list(after_head([b";a\n"], b"x")) == [b";a\n", b"x"]
    both = Deferred(b";TIME:5\nM73 R5\n", np.array([[0, 7], [8, 14]]), np.array([0.0, 1.0]))
    first, _, rest = after_head([both], b"x")
    assert isinstance(first, Deferred)
    assert isinstance(rest, Deferred)
    assert [first.text, rest.text] == [b";TIME:5\n", b"M73 R5\n"]
    assert [first.at.tolist(), rest.at.tolist()] == [[[0, 7]], [[0, 6]]]


@pytest.mark.parametrize(
    "text", [b";TIME:%b", b";TIME:%bh 3m", b";TIME_ELAPSED:%b:10:10", b"M73 P1 R%b"]
)
def test_a_corrupted_time_stays(text: bytes) -> None:
    line = text % (b"9" * 5000)
    assert with_times(line, 1.0, 100.0, 110.0) == line


@pytest.mark.parametrize(
    ("acceleration", "cause"),
    [(500.0, "slower corners and stops"), (300.0, "lower limits in the profile")],
)
def test_only_lowered_limits_are_blamed(tmp_path: Path, acceleration: float, cause: str) -> None:
    printer = hp.load_printer("example-ender")
    printer = replace(printer, limits=replace(printer.limits, acceleration=acceleration))
    strokes = [b"G1 X110 E0.4\n", b"G1 Z0.4\n", b"G1 X100 E0.4\n", b"G1 Z0.2\n"]
    lines = [b"G28\n", b"M83\n", b"G1 X100 Y100 Z0.2 F6000\n", *(60 * strokes)]
    found = hp.convert(lines, tmp_path / "o.gcode", printer, hp.Options(force=True, predict=()))
    assert f" s for {cause}" in found.time.as_row().text
