"""``hframe-post batch --scheduler``: on a real cluster of two processes, one of which is killed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.command_line import RECTANGLE, WAIT, run, until
from tests.conftest import SAMPLES

distributed = pytest.importorskip("distributed")
START = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None,
                      local_directory=sys.argv[1]) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a cluster in processes of its own."""
    folder = tmp_path_factory.mktemp("cluster")
    (folder / "start.py").write_text(START)
    command = [sys.executable, str(folder / "start.py"), str(folder)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        cwd=folder, text=True,
    ) as cluster:  # fmt: skip
        assert cluster.stdout is not None
        yield cluster.stdout.readline().strip()


def single(source: Path, folder: Path, *options: str | Path) -> bytes:
    assert run(source, "-q", "-o", folder / "single.gcode", *options).returncode == 0
    return (folder / "single.gcode").read_bytes()


def files_of(path: Path) -> list[dict[str, Any]]:
    files: list[dict[str, Any]] = json.loads(path.read_text())["files"]
    return files


@pytest.mark.slow
def test_the_bytes_are_those_of_this_machine(scheduler: str, tmp_path: Path) -> None:
    """With a profile that no worker has, and a name with spaces."""
    part, bad, own = tmp_path / "the part.gcode", tmp_path / "bad.gcode", tmp_path / "my own.toml"
    shutil.copy(RECTANGLE, part)
    bad.write_text("G28\nG1 X10 Y10\nG1 X9999\n")
    own.write_text('extends = "paper"\n[limits]\nacceleration = 4321\n[plant]\ninvented = false\n')
    expected = single(part, tmp_path, "-p", own)
    done = run("batch", part, bad, "-d", tmp_path / "out", "-p", own, "--scheduler", scheduler,
               "--json", tmp_path / "s.json")  # fmt: skip
    assert done.returncode == 1
    assert (tmp_path / "out" / part.name).read_bytes() == expected
    good, failed = files_of(tmp_path / "s.json")
    assert good["worker"].startswith("tcp://")
    assert failed["error"].startswith("line 3: ")
    assert [path.name for path in (tmp_path / "out").iterdir()] == [part.name]


@pytest.mark.slow
def test_the_job_of_a_killed_worker_is_done_by_another(scheduler: str, tmp_path: Path) -> None:
    """The worker dies while it converts."""
    long, part = tmp_path / "long.gcode", tmp_path / "part.gcode"
    long.write_bytes((SAMPLES / "cube.gcode").read_bytes().partition(b";LAYER:20\n")[0])
    shutil.copy(RECTANGLE, part)
    command = [sys.executable, "-m", "hframe_post", "batch", str(long), str(part), "-d",
               str(tmp_path / "out"), "--scheduler", scheduler, "--json",
               str(tmp_path / "s.json")]  # fmt: skip
    batch = subprocess.Popen(command, stderr=subprocess.PIPE)
    until(lambda: bool(converting(long.name)))
    (killed,) = {parent(pid) for pid in converting(long.name)}
    os.kill(killed, signal.SIGKILL)
    _, error = batch.communicate(timeout=5 * WAIT)  # the file is begun twice
    assert batch.returncode == 0, error
    assert (tmp_path / "out" / long.name).read_bytes() == single(long, tmp_path)
    assert (tmp_path / "out" / part.name).read_bytes() == single(part, tmp_path)
    assert not Path(f"/proc/{killed}").exists()


def converting(name: str) -> list[int]:
    """Conversions of that file: those that a worker began, not processes of theirs."""
    found = []
    for process in Path("/proc").iterdir():
        if process.name.isdigit():
            words = read(process / "cmdline").split(b"\0")
            if b"convert" in words and any(word.endswith(name.encode()) for word in words):
                found.append(int(process.name))
    return [pid for pid in found if parent(pid) not in found]


def parent(pid: int) -> int:
    """Return the parent of a process; 0 if it has ended."""
    return int(read(Path(f"/proc/{pid}/stat")).rpartition(b")")[2].split()[1:2][0] or 0)


def read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:  # the process is gone
        return b") S 0"
