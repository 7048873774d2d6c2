"""``hframe-post batch``: each file is converted as if it were alone."""

from __future__ import annotations

import json
import os
import shutil
import signal
import time
from functools import partial
from pathlib import Path

import pytest

from tests.command_line import RECTANGLE, WAIT, run, started, until
from tests.conftest import SAMPLES


@pytest.fixture
def jobs(tmp_path: Path) -> list[Path]:
    """Three good files and a bad one."""
    folder = tmp_path / "jobs"
    folder.mkdir()
    names = ("a.gcode", "bad one.gcode", "c.gcode")
    for name in names:
        shutil.copy(RECTANGLE, folder / name)
    (folder / "bad one.gcode").write_text("G28\nG1 X10 Y10\nG1 X9999\n")
    return [folder / name for name in names]


def test_one_failure_stops_no_other_and_the_bytes_are_those_of_single_runs(
    jobs: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done = run("batch", *jobs, "-d", out, "-j", "2", "--json", tmp_path / "s.json")
    assert done.returncode == 1
    assert b"2 converted, 0 skipped, 1 failed" in done.stderr
    run(jobs[0], "-o", tmp_path / "single.gcode")
    assert sorted(path.name for path in out.iterdir()) == ["a.gcode", "c.gcode"]
    for path in out.iterdir():
        assert path.read_bytes() == (tmp_path / "single.gcode").read_bytes()
    summary = json.loads((tmp_path / "s.json").read_text())
    assert [each["state"] for each in summary["files"]] == ["done", "failed", "done"]
    assert summary["files"][1]["error"].startswith("line 3: ")
    assert summary["files"][0]["summary"]["moves"] == 4
    assert "\x1b" not in done.stderr.decode()


def test_resume_converts_what_is_missing_changed_or_of_other_settings(
    jobs: list[Path], tmp_path: Path
) -> None:
    del jobs[1]
    again = partial(run, "batch", *jobs, "-d", tmp_path / "out", "--resume", "-j", "2")
    assert b"2 converted, 0 skipped" in again().stderr
    assert b"0 converted, 2 skipped" in again().stderr
    os.utime(jobs[0], (time.time() + 9, time.time() + 9))
    assert b"1 converted, 1 skipped" in again().stderr
    assert b"2 converted, 0 skipped" in again("-c", "fbs").stderr


def test_a_killed_process_is_a_failure_of_its_file_alone(jobs: list[Path], tmp_path: Path) -> None:
    long = tmp_path / "long.gcode"
    shutil.copy(SAMPLES / "prism.gcode", long)

    def converting() -> list[int]:
        text = " ".join(each.read_text() for each in children.glob("*/children"))
        lines = {int(pid): Path(f"/proc/{pid}/cmdline") for pid in text.split()}
        return [pid for pid, line in lines.items() if b"long.gcode" in line.read_bytes()]

    with started("batch", long, jobs[0], "-d", tmp_path / "out", "-j", "2") as batch:
        children = Path(f"/proc/{batch.pid}/task")
        until(lambda: bool(converting()))
        os.kill(converting()[0], signal.SIGKILL)
        _, error = batch.communicate(timeout=WAIT)
    assert batch.returncode == 1
    assert b"killed by SIGKILL" in error
    assert (tmp_path / "out" / "a.gcode").is_file()
    assert not (tmp_path / "out" / "long.gcode").exists()


def test_what_lands_in_a_watched_folder_is_converted(tmp_path: Path) -> None:
    pytest.importorskip("watchfiles")
    uploads, out = tmp_path / "uploads", tmp_path / "out"
    uploads.mkdir()
    with started("batch", "--watch", uploads, "-d", out) as batch:
        until(out.is_dir)
        shutil.copy(RECTANGLE, uploads / "part.gcode.part")  # an upload, renamed at its end
        (uploads / "part.gcode.part").rename(uploads / "part.gcode")
        (uploads / "notes.txt").write_text("no G-code")
        (uploads / "bad.gcode").write_text("nonsense without a move\n")
        until((out / "part.gcode").is_file)
        assert (out / "part.gcode").read_bytes().startswith(b"; processed by hframe-post")
        time.sleep(1.0)  # longer than it takes to notice a change
        assert [path.name for path in out.iterdir()] == ["part.gcode"]
        batch.send_signal(signal.SIGINT)
        _, error = batch.communicate(timeout=WAIT)
    assert error.count(b"failed") == 1  # the bad one, once


def test_wrong_usage(jobs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    for arguments in (
        ("-d", out),
        (jobs[0], "--watch", tmp_path, "-d", out),
        (jobs[0], jobs[0].parent / ".." / "jobs" / "a.gcode", "-d", out),
        (jobs[0], "-d", jobs[0].parent),
        ("--watch", jobs[0].parent, "-d", jobs[0].parent),
    ):
        assert run("batch", *arguments).returncode == 2
    assert run("batch", jobs[0], "-d", out, "-p", "nobody").returncode == 1
    assert jobs[0].read_bytes() == RECTANGLE.read_bytes()
