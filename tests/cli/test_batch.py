"""``hframe-post batch``: each file is converted as if it were alone."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from tests.command_line import RECTANGLE, WAIT, run, started, until
from tests.conftest import SAMPLES, few


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


@pytest.mark.slow
def test_one_failure_stops_no_other_job(jobs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = run("batch", *jobs, "-o", out, "-j", "2", "--json", tmp_path / "s.json")
    assert done.returncode == 1
    assert b"2 converted, 0 skipped, 1 failed" in done.stderr
    run(jobs[0], "-o", tmp_path / "single.gcode")
    assert sorted(path.name for path in out.iterdir()) == ["a.gcode", "c.gcode"]
    for path in out.iterdir():
        assert path.read_bytes() == (tmp_path / "single.gcode").read_bytes()
    summary = json.loads((tmp_path / "s.json").read_text())
    assert [each["state"] for each in summary["files"]] == ["done", "failed", "done"]
    assert summary["files"][1]["error"].startswith("line 3: ")
    assert summary["files"][1]["line"] == 3
    assert (summary["status"], summary["failed"], summary["interrupted"]) == (1, 1, False)
    *_, again, counts = done.stderr.decode().splitlines()
    assert b"WARNING" not in done.stderr
    assert again.startswith(f"failed  {jobs[1]}: line 3: ")
    assert counts == "2 converted, 0 skipped, 1 failed; --resume tries only those again"
    assert summary["files"][0]["summary"]["moves"] == 4
    assert "\x1b" not in done.stderr.decode()


def test_what_is_not_compensated_is_said_at_the_end(tmp_path: Path) -> None:
    for name, share in (("a", 3.29), ("b", 0.01)):
        lines = ("M83", "G1 X100 Y100 Z0.2 F6000", f"G1 X150 E{10 - share} F3000", "A_MACRO")
        (tmp_path / f"{name}.gcode").write_text("\n".join([*lines, f"G1 X160 E{share}\n"]))
    done = run("batch", tmp_path, "-o", tmp_path / "out", "-j", "1")
    assert done.returncode == 0
    warning = "32.9 % of the extrusion is not compensated, mostly after A_MACRO"
    shown = done.stderr.decode().splitlines()
    assert shown[-2].startswith(f"WARNING {tmp_path}/a.gcode: {warning}")
    assert shown[-1] == "2 converted, 0 skipped, 0 failed, 1 with warnings"


@pytest.mark.slow
def test_what_lies_in_the_folder_is_not_run(tmp_path: Path) -> None:
    """In the folder of the sources, for example, whose compiled part is not built."""
    fake = tmp_path / "hframe_post" / "__init__.py"
    fake.parent.mkdir()
    fake.write_text("raise ImportError('not the tool')\n")
    shutil.copy(RECTANGLE, tmp_path / "a.gcode")
    own = [sys.executable, "-P", "-m", "hframe_post"]
    done = subprocess.run(
        [*own, "batch", "a.gcode", "-o", "out"], cwd=tmp_path, capture_output=True, check=False
    )
    assert (done.returncode, done.stderr.decode().splitlines()[-1]) == (
        0, "1 converted, 0 skipped, 0 failed",
    )  # fmt: skip


@pytest.mark.slow
def test_a_folder_keeps_its_subfolders(tmp_path: Path) -> None:
    jobs, out = tmp_path / "jobs", tmp_path / "jobs" / "out"
    for name in ("a.gcode", "x/a.GCO", "x/y/a.gcode", ".hidden/a.gcode", "x/._a.gcode", "x/a.txt"):
        (jobs / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(RECTANGLE, jobs / name)
    converted = ["a.gcode", "x/a.GCO", "x/y/a.gcode"]
    for expected in (b"3 converted, 0 skipped", b"0 converted, 3 skipped"):
        done = run("batch", jobs, "-o", out, "--resume")
        assert done.returncode == 0, done.stderr
        assert expected in done.stderr
        files = sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file())
        assert files == converted
    nothing = run("batch", jobs / ".hidden" / "..", "-o", jobs)
    assert nothing.returncode == 2
    assert b"would replace the input" in nothing.stderr
    (tmp_path / "empty").mkdir()
    nothing = run("batch", tmp_path / "empty", "-o", out)
    assert (nothing.returncode, b"empty holds no G-code" in nothing.stderr) == (2, True)


def test_two_files_of_one_name_are_both_named(tmp_path: Path) -> None:
    paths = [tmp_path / name / "part.gcode" for name in ("a", "b")]
    for path in paths:
        path.parent.mkdir()
        shutil.copy(RECTANGLE, path)
    done = run("batch", *paths, "-o", tmp_path / "out")
    assert done.returncode == 2
    assert f"{paths[0]} and {paths[1]} would both be written to" in done.stderr.decode()
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("number", few([signal.SIGINT, signal.SIGTERM], 1))
def test_an_interruption_reports(jobs: list[Path], tmp_path: Path, number: signal.Signals) -> None:
    long, last = tmp_path / "long.gcode", tmp_path / "last.gcode"
    shutil.copy(SAMPLES / "prism.gcode", long)
    shutil.copy(RECTANGLE, last)
    out, summary = tmp_path / "out", tmp_path / "s.json"
    with started(
        "batch", jobs[0], jobs[1], long, last, "-o", out, "-j", "1", "--json", summary
    ) as batch:
        assert batch.stderr is not None
        while not batch.stderr.readline().startswith(b"failed"):
            assert batch.poll() is None
        until(lambda: bool(list(out.glob(".*.tmp"))))  # of the long one
        batch.send_signal(number)
        _, error = batch.communicate(timeout=WAIT)
    assert batch.returncode == -number  # a shell says 128 + number
    found = json.loads(summary.read_text())
    assert (found["status"], found["interrupted"]) == (128 + number, True)
    states = [each["state"] for each in found["files"]]
    assert states == ["done", "failed", "stopped", "stopped"]
    text = error.decode()
    assert text.count(f"failed  {jobs[1]}: line 3: ") == 1  # once more
    assert "1 converted, 0 skipped, 1 failed, 2 not converted; --resume" in text
    assert [path.name for path in out.iterdir()] == ["a.gcode"]


@pytest.mark.slow
def test_resume_converts_what_is_missing_or_changed(jobs: list[Path], tmp_path: Path) -> None:
    del jobs[1]
    again = partial(run, "batch", *jobs, "-o", tmp_path / "out", "--resume", "-j", "2")
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

    with started("batch", long, jobs[0], "-o", tmp_path / "out", "-j", "2") as batch:
        children = Path(f"/proc/{batch.pid}/task")
        until(lambda: bool(converting()))
        os.kill(converting()[0], signal.SIGKILL)
        _, error = batch.communicate(timeout=WAIT)
    assert batch.returncode == 1
    assert b"killed by SIGKILL" in error
    assert (tmp_path / "out" / "a.gcode").is_file()
    assert not (tmp_path / "out" / "long.gcode").exists()


def test_wrong_usage(jobs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    for arguments in (
        ("-o", out),
        (jobs[0], "--watch", tmp_path, "-o", out),
        (jobs[0], jobs[0].parent / ".." / "jobs" / "a.gcode", "-o", out),
        (jobs[0], "-o", jobs[0].parent),
    ):
        assert run("batch", *arguments).returncode == 2
    assert run("batch", jobs[0], "-o", out, "-p", "nobody").returncode == 1
    assert jobs[0].read_bytes() == RECTANGLE.read_bytes()
