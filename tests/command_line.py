"""Run the command line in a process of its own, as its users do."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from tests.conftest import SAMPLES

RECTANGLE = SAMPLES / "rectangle.gcode"
WAIT = 60.0  # s


def run(
    *arguments: str | Path, stdin: bytes = b"", **environment: str
) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "hframe_post", *map(str, arguments)],
        input=stdin, capture_output=True, check=False, env={**os.environ, **environment},
    )  # fmt: skip


def until(holds: Callable[[], bool]) -> None:
    """Wait until ``holds()`` is true; fail after a minute."""
    deadline = time.monotonic() + WAIT
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)
