"""Binary G-code as input and output, through libbgcode."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from hframe_post.conversion import files
from hframe_post.errors import GcodeError
from hframe_post.gcode.lines import as_binary, as_text, is_binary, lines_of
from tests.command_line import run
from tests.gcode_tools import follow
from tests.slices import SLICES

pytest.importorskip("pybgcode", reason="pip install pybgcode-jneilliii")
TEXT = b"".join(SLICES["prusaslicer"].lines)


def binary(text: bytes = TEXT) -> bytes:
    target = io.BytesIO()
    with as_binary(target) as file:
        file.write(text)
    return target.getvalue()


def test_text_comes_back() -> None:
    packed = binary()
    assert packed.startswith(b"GCDE")
    with as_text(packed[:10], io.BytesIO(packed[10:])) as file:
        text = file.read()
    reading = follow(text)
    assert b"EXCLUDE_OBJECT_START NAME=cube_id_0_copy_0" in text.splitlines()
    assert reading.points == follow(TEXT).points
    assert reading.filament == pytest.approx(follow(TEXT).filament)


@pytest.mark.parametrize("cut", [12, 60, 0.3, 0.9])
def test_a_truncated_or_damaged_file_is_an_error(cut: float) -> None:
    packed = binary()
    at = int(cut if cut >= 1 else cut * len(packed))
    for broken in (packed[:at], packed[:at] + bytes([packed[at] ^ 255]) + packed[at + 1 :]):
        with pytest.raises(GcodeError, match="binary G-code cannot be read"):
            list(lines_of(io.BytesIO(broken)))


def test_converting_in_place_stays_binary(tmp_path: Path) -> None:
    part = tmp_path / "part.gcode.pp"
    part.write_bytes(binary())
    assert run(str(part)).returncode == 0
    assert is_binary(part)
    with part.open("rb") as file:
        text = b"".join(lines_of(file))
    assert b"; processed by hframe-post" in text
    assert b"; hframe-post: print time" in text
    assert follow(text).filament == pytest.approx(follow(TEXT).filament, abs=1e-3)
    once = part.read_bytes()
    again = run(str(part))
    assert again.returncode == 0
    assert b"already" in again.stderr
    assert part.read_bytes() == once


def test_the_suffix_of_the_output_decides(tmp_path: Path) -> None:
    (tmp_path / "in.gcode").write_bytes(TEXT)
    assert run(str(tmp_path / "in.gcode"), "-o", str(tmp_path / "out.bgcode")).returncode == 0
    assert is_binary(tmp_path / "out.bgcode")
    assert run(str(tmp_path / "out.bgcode"), "-o", str(tmp_path / "o.gcode")).returncode == 1
    (tmp_path / "in.bgcode").write_bytes(binary())
    assert run(str(tmp_path / "in.bgcode"), "-o", str(tmp_path / "o.gcode")).returncode == 0
    assert b"; processed by hframe-post" in (tmp_path / "o.gcode").read_bytes()
    fast = run(str(tmp_path / "in.bgcode"), "-o", str(tmp_path / "f.gcode"), "--max-error", "1mm")
    assert fast.returncode == 0, fast.stderr
    assert files.chosen_format(Path("a.bgcode"), None) == "bgcode"
