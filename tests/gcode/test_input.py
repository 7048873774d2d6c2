"""Input: lines of a file, of an open file or of a list, once or several times."""

import io
import os
import threading
from pathlib import Path

import pytest

from hframe_post.errors import ArgumentError
from hframe_post.gcode.lines import Input
from tests.command_line import RECTANGLE, run
from tests.conftest import MEASURED

LINES = [b"G28\n", b"G1 X10\n"]


def test_a_file_and_a_list_can_be_read_again(tmp_path: Path) -> None:
    path = tmp_path / "in.gcode"
    path.write_bytes(b"".join(LINES))
    for given in (Input(path), Input(str(path)), Input(LINES)):
        counted = list[int]()
        assert list(given.lines(counted.append)) == list(given.again()) == LINES
        assert sum(counted) == 11
        assert not given.once


def test_a_stream_cannot() -> None:
    for given in (Input(io.BytesIO(b"".join(LINES))), Input(iter(LINES))):
        assert given.once
        assert list(given.lines()) == LINES
        with pytest.raises(ArgumentError, match="a path or a list of lines"):
            given.again()


@pytest.mark.skipif(os.name != "posix", reason="no named pipes")
def test_a_named_pipe_is_opened_once(tmp_path: Path) -> None:
    pipe, out = tmp_path / "pipe", tmp_path / "out.gcode"
    os.mkfifo(pipe)
    writing = threading.Thread(target=pipe.write_bytes, args=(RECTANGLE.read_bytes(),))
    writing.start()
    assert run(pipe, "-o", out, "-q", "-p", MEASURED).returncode == 0
    writing.join()
    assert out.stat().st_size
