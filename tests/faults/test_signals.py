"""Signals at any time: the input is whole, old or new; no file is left; no traceback is shown."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.conftest import ROOT, SAMPLES

RECTANGLE = (SAMPLES / "rectangle.gcode").read_bytes()
TIDY = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


def started(*arguments: str | Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "hframe_post", *map(str, arguments)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip


def temporary(folder: Path) -> list[Path]:
    return list(folder.glob(".hframe-post-*.tmp"))


@pytest.mark.parametrize("number", TIDY, ids=lambda s: s.name)
def test_a_killed_conversion_tidies_up_and_says_nothing(
    tmp_path: Path, number: signal.Signals
) -> None:
    with (SAMPLES / "cube.gcode").open("rb") as cube:
        command = [sys.executable, "-m", "hframe_post", "-", "-o", str(tmp_path / "out.gcode")]
        process = subprocess.Popen(
            command, stdin=cube, stderr=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(ROOT)}
        )
        while not temporary(tmp_path):
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(number)
        _, told = process.communicate(timeout=60.0)
    assert (process.returncode, told) == (-number, b"")
    assert not list(tmp_path.iterdir())


def test_what_a_kill_leaves_is_removed_by_the_next_run(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "hframe_post", "-", "-o", str(tmp_path / "out.gcode")],
        stdin=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    while not temporary(tmp_path):
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.communicate()
    assert temporary(tmp_path)
    part = tmp_path / "part.gcode"
    part.write_bytes(RECTANGLE)
    finished = started(part, "-q")
    finished.communicate(timeout=60.0)
    assert finished.returncode == 0
    assert [path.name for path in tmp_path.iterdir()] == ["part.gcode"]


def at_random(folder: Path, count: int, seed: int) -> None:
    """So many signals, at random times of a conversion in place."""
    rng, part = random.Random(seed), folder / "part.gcode"
    part.write_bytes(RECTANGLE)
    begun = time.monotonic()
    process = started(part, "-q")
    process.communicate()
    assert process.returncode == 0
    whole, converted = time.monotonic() - begun, part.read_bytes()
    for _ in range(count):
        for stale in temporary(folder):
            stale.unlink()
        number = rng.choice((*TIDY, signal.SIGKILL))
        part.write_bytes(RECTANGLE)
        process = started(part)
        time.sleep(rng.uniform(0.15, 1.3) * whole)  # before, it is Python that starts
        process.send_signal(number)
        _, told = process.communicate()
        assert part.read_bytes() in (RECTANGLE, converted)
        assert process.returncode in (0, -number)
        if process.returncode == 0:
            assert part.read_bytes() == converted
        if number != signal.SIGKILL:
            assert not temporary(folder)
        for word in (b"Traceback", b"Exception", b"leaked", b"Error"):
            assert word not in told, told.decode()


def test_signals_at_random_times(tmp_path: Path) -> None:
    at_random(tmp_path, 6, seed=1)


@pytest.mark.slow
def test_many_signals_at_random_times(tmp_path: Path) -> None:
    at_random(tmp_path, 200, seed=2)
