"""Commands that messages and slicers get can be typed as they stand, whatever files are called."""

import shlex
import subprocess
from pathlib import Path

import pytest

from hframe_post.cli.connect import line
from hframe_post.cli.parameters import quoted
from tests.command_line import run
from tests.conftest import MEASURED
from tests.printers import M503, REAL


@pytest.mark.parametrize(
    "name",
    ["a.toml", "my a.toml", "a(2).toml", "a&b.toml", "5$a.toml", 'a"b.toml', "a`b`.toml", "a\\b"],
)
def test_a_shell_takes_a_quoted_path_as_one_word(name: str) -> None:
    command = ["sh", "-c", f"printf '%s;' {quoted(Path('größe') / name)}"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert shown == f"größe/{name};"
    assert quoted("printer.toml") == "printer.toml"


@pytest.mark.parametrize("source", [REAL, M503], ids=["printer.cfg", "m503.txt"])
def test_the_next_command_can_be_typed(source: Path, tmp_path: Path) -> None:
    home = tmp_path / "Drucker (neu)"
    home.mkdir()
    named = home / f"my {source.name}"
    named.write_bytes(source.read_bytes())
    done = run("setup", named, "-o", home, XDG_CONFIG_HOME=str(tmp_path), HFRAME_PRINTER="")
    assert done.returncode == 0, done.stderr
    own, tower = home / "printer.toml", home / "the tower.gcode"
    advised = done.stdout.decode().partition("hframe-post identify recordings")[2].splitlines()[0]
    assert shlex.split(advised)[-1] == str(own)
    printed = run("calibrate-print", "-p", own, "--heat", "210,60", "-o", tower)
    assert printed.returncode == 0, printed.stderr
    words = shlex.split(printed.stderr.decode().partition("hframe-post calibrate-print")[2])
    assert words == ["-p", str(own), "--form", str(home / "the tower.form.toml"), "-o", str(own)]


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
