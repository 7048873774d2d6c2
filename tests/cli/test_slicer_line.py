"""The line for slicers; tests/cli/test_prusaslicer.py pastes it into the real one."""

import subprocess
from pathlib import Path

from hframe_post.cli.connect import line
from tests.command_line import run
from tests.conftest import MEASURED


def test_the_line_runs_this_installation_with_the_profile(tmp_path: Path) -> None:
    own = tmp_path / "my printer's $5 (new).toml"
    own.write_bytes(MEASURED.read_bytes())
    done = run("connect", "slicer", "-p", own)
    (printed,) = done.stdout.decode().splitlines()
    shell = ["sh", "-c", f"printf '%s\\n' {printed}"]  # as slicers run it
    words = subprocess.run(shell, capture_output=True, text=True, check=True).stdout.splitlines()
    program, *_, option, profile = words
    assert Path(program).is_absolute()
    assert Path(program).is_file()
    assert (option, profile) == ("-p", str(own))
    assert "Post-processing scripts" in done.stderr.decode()
    assert b"no such profile" in run("connect", "slicer", "-p", "nobody").stderr


def test_windows_takes_double_quotes_and_no_escapes() -> None:
    words = [r"C:\Users\Rosa Luz\bin\hframe-post.exe", "-p", r"D:\prints\my printer.toml"]
    shown = r'"C:\Users\Rosa Luz\bin\hframe-post.exe" -p "D:\prints\my printer.toml"'
    assert line(words, windows=True) == shown
    assert line([r"C:\bin\hframe-post.exe"], windows=True) == r"C:\bin\hframe-post.exe"
    assert line(["/opt/3d tools/hframe-post"], windows=False) == '"/opt/3d tools/hframe-post"'
