"""Commands that messages advise can be typed as they stand, whatever the files are called."""

import shlex
import subprocess
from pathlib import Path

import pytest

from hframe_post.cli.parameters import quoted
from tests.command_line import run
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
