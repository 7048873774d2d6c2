"""Mainline Klipper plays files as Kalico does, which is the host of all other tests."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

MAINLINE = os.environ.get("MAINLINE_KLIPPER", "")
SET = ("test_host.py", "test_playback.py")
LIVE = ("../live/test_host.py::test_the_hosts_steps_are_the_kernels",)


@pytest.mark.klipper
@pytest.mark.slow
@pytest.mark.skipif(not MAINLINE, reason="no source of mainline Klipper here: make programs")
@pytest.mark.parametrize(("names", "marked"), [(SET, "not slow"), (LIVE, "slow")])
def test_mainline_plays_the_set_as_well(names: tuple[str, ...], marked: str) -> None:
    files = [str(Path(__file__).parent / name) for name in names]
    command = [sys.executable, "-m", "pytest", "-q", "-m", marked, "-p", "no:cacheprovider", *files]
    environment = {name: text for name, text in os.environ.items() if "PYTEST" not in name}
    result = subprocess.run(
        command,
        cwd=Path(__file__).parents[2],
        env=environment | {"KLIPPER": MAINLINE},
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert result.returncode == 0, result.stdout[-4000:] + result.stderr[-1000:]
