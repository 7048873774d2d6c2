"""Lines of an input as words: read as firmwares do, in linear time."""

import io
import os
import re
import threading
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.errors import ArgumentError, GcodeError
from hframe_post.gcode.commands import LIMIT_PARAMETERS, Line, command, parameters, uncommented
from hframe_post.gcode.lines import Input, Lines
from tests.command_line import RECTANGLE, run
from tests.conftest import MEASURED


def stripped(text: bytes) -> bytes:
    """Return the text without comments, removed innermost first: simple, but quadratic in time."""
    while (shorter := re.sub(rb"\([^()]*\)|;.*", b" ", text)) != text:
        text = shorter
    return text


@given(st.text("aG1 ()").map(str.encode), st.text("aG1 ;").map(str.encode))
def test_comments_go_whatever_their_nesting(text: bytes, rest: bytes) -> None:
    text += rest
    assert uncommented(text).split() == stripped(text).split()


@pytest.mark.parametrize(
    ("text", "kept"),
    [(b"G1 (a ; b) X5 ; c (d)", b"G1   X5 "), (b"(();)X", b" X"), (b"a) ; (b", b"a) ")],
)
def test_the_form_that_begins_first_wins(text: bytes, kept: bytes) -> None:
    assert uncommented(text) == kept


def test_comments_take_linear_time() -> None:
    start = time.process_time()
    assert uncommented(b"(" * 200_000 + b")" * 200_000 + b"G1") == b" G1"
    assert uncommented(b"(" * 200_000 + b"G1") == b"(" * 200_000 + b"G1"
    assert time.process_time() - start < 2.0


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (b"G 91", "G91"), (b"M 82", "M82"), (b"(c) G91", "G91"), (b"N 5 G91", "G91"),
        (b"n5g091", "G91"), (b"G1X5", "G1"), (b"G92.1", "G92.1"), (b"T0", "T0"),
        (b"G" + b"9" * 5000, None), (b"G92." + b"9" * 5000, "G92"), (b"GOTO 1", None),
        (b"T0_PARK", "T0"), (b"G1_0 X5", "G1"), (b"N5", None), (b"", None),
    ],
)  # fmt: skip
def test_coded_commands(text: bytes, name: str | None) -> None:
    coded = command(Line(1, text))
    assert (coded.name if coded else None) == name


@pytest.mark.parametrize(
    ("text", "acceleration"),
    [
        ("ACCEL=1e4", 1e4), ("ACCEL='500'", 500), ('accel="500"', 500), ("ACCEL=1_000", 1000),
        ("VELOCITY=5 ACCEL=+3.5E2 ; fast", 350), ("ACCEL=1 ACCEL=700", 700), ("ACCEL=9 # 8", 9),
        ("OTHER=x ACCEL=800", 800),
    ],
)  # fmt: skip
def test_parameters_are_read_as_klipper_reads_them(text: str, acceleration: float) -> None:
    line = Line(1, b"SET_VELOCITY_LIMIT " + text.encode())
    assert parameters(line, LIMIT_PARAMETERS)["ACCEL"] == acceleration


@pytest.mark.parametrize("text", ["ACCEL=", "ACCEL=fast", "ACCEL='5", "ACCEL", "ACCEL=nan"])
def test_parameters_that_klipper_refuses_are_refused(text: str) -> None:
    with pytest.raises(GcodeError):
        parameters(Line(1, b"SET_VELOCITY_LIMIT " + text.encode()), LIMIT_PARAMETERS)


LINES = [b"G28\n", b"G1 X10\n"]
TEXT = b"".join(LINES)  # a file gives many lines in a text


def test_a_file_and_a_list_can_be_read_again(tmp_path: Path) -> None:
    path = tmp_path / "in.gcode"
    path.write_bytes(TEXT)
    for form in (path, str(path), LINES):
        counted = list[int]()
        source = Input(form, counted.append)
        assert b"".join(source.lines()) == b"".join(source.lines()) == TEXT
        assert sum(counted) == 11
        assert not source.once


def test_a_stream_cannot() -> None:
    for source in (Input(io.BytesIO(TEXT)), Input(iter(LINES))):
        assert source.once
        assert b"".join(source.lines()) == TEXT
        with pytest.raises(ArgumentError, match="a path or a list of lines"):
            source.again()


@pytest.mark.parametrize("text", [b"", b"G28", b"G28\n\nG1 X5", b";" * 600_000 + b"\nM106\n" * 9])
def test_texts_of_a_file_end_where_lines_do(text: bytes) -> None:
    texts = list(Input(io.BytesIO(text)).lines())
    assert b"".join(texts) == text
    assert all(each.endswith(b"\n") for each in texts[:-1])
    assert [*Lines(iter(texts))] == [*Lines(iter(text.splitlines(keepends=True)))]


@pytest.mark.skipif(os.name != "posix", reason="no named pipes")
def test_a_named_pipe_is_opened_once(tmp_path: Path) -> None:
    pipe, out = tmp_path / "pipe", tmp_path / "out.gcode"
    os.mkfifo(pipe)
    writing = threading.Thread(target=pipe.write_bytes, args=(RECTANGLE.read_bytes(),))
    writing.start()
    assert run(pipe, "-o", out, "-q", "-p", MEASURED).returncode == 0
    writing.join()
    assert out.stat().st_size
