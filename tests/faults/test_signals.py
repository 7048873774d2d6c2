"""Signals at any time: the input is whole, old or new; no file is left; no traceback is shown."""

import contextlib
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from tests.command_line import run, until
from tests.conftest import ROOT, SAMPLES
from tests.gcode_tools import SPANS

RECTANGLE = (SAMPLES / "rectangle.gcode").read_bytes()
SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGKILL, signal.SIGPIPE)


def started(
    *arguments: str | Path, folder: Path | None = None, stdin: int | None = None
) -> subprocess.Popen[bytes]:
    """In a process group of its own."""
    command = [sys.executable, "-m", "hframe_post", *map(str, arguments)]
    return subprocess.Popen(
        command, stdin=stdin, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=folder,
        start_new_session=True, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip


def temporary(folder: Path) -> list[Path]:
    return list(folder.rglob(".hframe-post-*.tmp"))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_killed_conversion_says_nothing_and_leaves_nothing(
    tmp_path: Path, number: signal.Signals
) -> None:
    """At once on SIGTERM; what SIGKILL leaves is removed by the next run."""
    with started("-", "-o", tmp_path / "out.gcode", stdin=subprocess.PIPE) as process:
        until(lambda: bool(temporary(tmp_path)))
        process.send_signal(number)
        _, printed = process.communicate()
    assert (process.returncode, printed) == (-number, b"")
    assert bool(temporary(tmp_path)) == (number == signal.SIGKILL)
    part = tmp_path / "part.gcode"
    part.write_bytes(RECTANGLE)
    assert run(part, "-q").returncode == 0
    assert [path.name for path in tmp_path.iterdir()] == ["part.gcode"]


PARTS = {"part": RECTANGLE, "spans": SPANS}
WAYS = {  # arguments, and what they make of which part
    "in place": (["part.gcode", "--jobs", "1"], {"part.gcode": "part"}),
    "two processes": (["spans.gcode", "--jobs", "2"], {"spans.gcode": "spans"}),
    "batch": (
        ["batch", "part.gcode", "spans.gcode", "-o", "out", "-j", "2"],
        {"out/part.gcode": "part", "out/spans.gcode": "spans"},
    ),
}
TOLD = (b"Traceback", b"Exception", b"leaked", b"Error")


def at_random(folder: Path, count: int, seed: int) -> Counter[str]:
    """So many signals, each at a random time of a random conversion; what came of them."""
    rng, whole, seen = random.Random(seed), dict[str, float](), Counter[str]()
    converted: dict[str, bytes] = {}
    for way, (arguments, made) in WAYS.items():
        begun = time.monotonic()
        _renew(folder)
        process = started(*arguments, folder=folder)
        process.communicate()
        assert process.returncode == 0
        whole[way] = time.monotonic() - begun
        for name, part in made.items():
            text = (folder / name).read_bytes()
            assert converted.setdefault(part, text) == text
    for _ in range(count):
        before = temporary(folder)
        _renew(folder)
        way = rng.choice(("in place", "in place", "two processes", "batch"))
        number, group = rng.choice(SIGNALS), rng.random() < 0.3
        process = started(*WAYS[way][0], folder=folder)
        if number == signal.SIGINT:  # before, it is Python that starts
            until(lambda process=process: _catches(process.pid, signal.SIGTERM))  # type: ignore[misc]
        time.sleep(rng.uniform(0.0, 1.3) * whole[way])
        (os.killpg if group else os.kill)(process.pid, number)
        _, printed = process.communicate()
        outcome = process.returncode
        assert outcome in (0, -number), (way, number, group, outcome, printed)
        until(lambda: not _alive(folder))
        for name, part in WAYS[way][1].items():
            old = {b"" if way == "batch" else PARTS[part], converted[part]}
            file = folder / name
            text = file.read_bytes() if file.exists() else b""
            assert text in ({converted[part]} if outcome == 0 else old), (way, number, name)
        if way == "batch":
            for part, text in PARTS.items():
                assert (folder / f"{part}.gcode").read_bytes() == text
        if not (number == signal.SIGKILL and (way != "batch" or group)):
            assert set(temporary(folder)) <= set(before), (way, number, group)
        assert not any(word in printed for word in TOLD), printed.decode()
        seen[f"{way}, {number.name}, {'finished' if outcome == 0 else 'ended'}"] += 1
    if temporary(folder):  # of SIGKILL
        _renew(folder)
        for way in ("in place", "batch"):
            started(*WAYS[way][0], folder=folder).communicate()
            _renew(folder)
    assert not temporary(folder)
    return seen


def _renew(folder: Path) -> None:
    for part, text in PARTS.items():
        (folder / f"{part}.gcode").write_bytes(text)
    for file in (folder / "out").glob("*.gcode"):
        file.unlink()


def _catches(pid: int, number: signal.Signals) -> bool:
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return False
    [caught] = re.findall(r"SigCgt:\s*(\w+)", status)
    return bool(int(caught, 16) >> (number - 1) & 1)


def _alive(folder: Path) -> list[int]:
    """Processes that work in this folder."""
    found = []
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            if entry.name.isdigit() and (entry / "cwd").readlink() == folder:
                found.append(int(entry.name))
    return found


@pytest.mark.slow
def test_signals_at_random_times(tmp_path: Path) -> None:
    at_random(tmp_path.resolve(), 25, seed=1)
