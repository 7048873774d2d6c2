"""Streams that are closed or full, disks that are full, names that are hostile: exit status,
one line of error, and whatever was there is still there."""

import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.command_line import run
from tests.conftest import ROOT, SAMPLES, few

RECTANGLE = SAMPLES / "rectangle.gcode"
OWN = 'extends = "paper"\n[plant]\ninvented = false\n'
ME = f"{sys.executable} -m hframe_post"


def shell(command: str, folder: Path, **more: Callable[[], None]) -> tuple[int, str]:
    """Exit status and what was said on errors."""
    done = subprocess.run(
        ["bash", "-c", command], cwd=folder, capture_output=True, check=False, timeout=300,
        env={**os.environ, "ME": ME, "PYTHONPATH": str(ROOT)}, **more,  # type: ignore[call-overload]
    )  # fmt: skip
    return done.returncode, done.stderr.decode()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(RECTANGLE, tmp_path / "in.gcode")
    (tmp_path / "my.toml").write_text(OWN)
    return tmp_path


def refused(done: tuple[int, str], folder: Path, cause: str) -> None:
    """Exit 1 with one line; the input is as it was and nothing is next to it."""
    status, printed = done
    assert (status, printed.count("\n")) == (1, 1), printed
    assert cause in printed
    assert (folder / "in.gcode").read_bytes() == RECTANGLE.read_bytes()
    assert {p.name for p in folder.iterdir()} == {"in.gcode", "my.toml"}


@pytest.mark.parametrize(
    ("command", "cause"),
    few(
        [
            ("$ME - <in.gcode >&-", "Bad file descriptor"),
            ("$ME - <in.gcode >/dev/full", "No space left"),
            ("$ME in.gcode -q --json - >/dev/full", "No space left"),
        ],
        1,
    ),
)
def test_what_cannot_be_done_touches_nothing(folder: Path, command: str, cause: str) -> None:
    refused(shell(command, folder), folder, cause)
    assert (folder / "my.toml").read_text() == OWN


@pytest.mark.parametrize(
    ("command", "cause"),
    [
        ("in.gcode -q -o /dev/full", "No space left"),
        ("in.gcode -q --json no/summary.json", "no/summary.json: the folder no does not exist"),
        ("in.gcode -q --json in.gcode", "is already read or written by this command"),
        ("in.gcode -q -p my.toml -o my.toml", "is already read or written by this command"),
    ],
)
def test_an_output_that_cannot_be_made_touches_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch, command: str, cause: str
) -> None:
    monkeypatch.chdir(folder)
    done = run(*command.split())
    refused((done.returncode, done.stderr.decode()), folder, cause)
    assert (folder / "my.toml").read_text() == OWN


@pytest.mark.parametrize(
    "command", few(["$ME in.gcode <&- >&- 2>&-", "$ME in.gcode 2>/dev/full"], 1)
)
def test_what_nobody_hears_is_done_all_the_same(folder: Path, command: str) -> None:
    assert shell(command, folder)[0] == 0
    assert b"; processed by hframe-post" in (folder / "in.gcode").read_bytes()


def test_a_full_disk_in_the_middle_of_a_print(folder: Path) -> None:
    """The stages that run ahead are stopped, and leave nothing to be complained about."""
    shutil.copy(SAMPLES / "cube.gcode", folder / "in.gcode")

    def small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 18, 1 << 18))

    status, printed = shell("$ME in.gcode", folder, preexec_fn=small)
    assert (status, printed) == (1, f"Error: {printed[7:]}")
    assert printed.count("\n") == 1
    assert (folder / "in.gcode").read_bytes() == (SAMPLES / "cube.gcode").read_bytes()
    assert {p.name for p in folder.iterdir()} == {"in.gcode", "my.toml"}


@pytest.mark.parametrize("name", few([b"two\nlines", b"\xe9", b"esc\x1b[2J"], 1))
def test_names_reach_the_output_as_one_printable_line(folder: Path, name: bytes) -> None:
    profile = os.path.join(os.fsencode(folder), name + b".toml")
    Path(os.fsdecode(profile)).write_text(OWN)
    target = os.path.join(os.fsencode(folder), name + b".gcode")
    words = [os.fsencode(sys.executable), b"-m", b"hframe_post", b"in.gcode", b"-p", profile]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([*words, b"-o", target], cwd=folder, capture_output=True, check=False,
                          env=environment)  # fmt: skip
    assert done.returncode == 0, done.stderr
    with open(target, "rb") as file:
        lines = file.read().splitlines()
    assert b"; processed by hframe-post" in lines[1]
    known = RECTANGLE.read_bytes().splitlines()
    for line in lines:
        assert line.decode().isprintable()
        assert line.startswith((b";", b"G1 ", b"M", b"SET_", b"G9", b"G4 ")) or line in known


ON_A_DISK = """
mount -t tmpfs -o size=200k none disk || exit 99
cp in.gcode disk && cd disk && mount -o "remount,$OPTIONS" "$PWD" || exit 99
eval "$COMMAND"
status=$?
cmp in.gcode ../in.gcode >&2 && [ "$(ls -A)" = in.gcode ] && exit $status
exit 98
"""


@pytest.mark.parametrize(
    ("options", "to", "cause"),
    few([("rw", "", "/disk: No space left"), ("ro", "-o out.gcode", "Read-only file system")], 1),
)
def test_a_disk_that_cannot_be_written(folder: Path, options: str, to: str, cause: str) -> None:
    """A small one, mounted where only this test sees it, which takes no root."""
    if shutil.which("unshare") is None or shell("unshare -rm mount -t tmpfs none .", folder)[0]:
        pytest.skip("no disk can be mounted here")
    lines = (SAMPLES / "cube.gcode").read_bytes().splitlines(keepends=True)[:1200]
    (folder / "in.gcode").write_bytes(b"".join(lines))
    (folder / "disk").mkdir()
    command = f"{ME} in.gcode -q {to}"
    env = {**os.environ, "PYTHONPATH": str(ROOT), "OPTIONS": options, "COMMAND": command}
    done = subprocess.run(
        ["unshare", "-rm", "bash", "-c", ON_A_DISK],
        cwd=folder, env=env, capture_output=True, check=False, timeout=300,
    )  # fmt: skip
    printed = done.stderr.decode()
    assert (done.returncode, printed.count("\n")) == (1, 1), printed
    assert cause in printed
