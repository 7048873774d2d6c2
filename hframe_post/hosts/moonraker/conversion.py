"""hframe-post as a process: its conversion of a file, and its other commands."""

from __future__ import annotations

import os
import re
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from .disk import NAME, FailureError, GoneError
from .interface import Interface

LOG = re.compile(r"\s*\d+\.\d{3} s  (?P<text>.*)")  # of hframe-post -v
PERCENT = re.compile(r"(?P<percent>\d+ %) is read")
WATCH = 0.3  # s between two looks whether the user has deleted the file


def converted(
    source: Path, target: Path, name: str, command: Sequence[str], interface: Interface,
    is_gone: Callable[[], bool],
) -> tuple[str, bool]:  # fmt: skip
    """Convert a file, and return the summary and whether there was anything to convert.

    name: of the source for people. is_gone: whether the user has deleted the file meanwhile. Raises
    FailureError with the reason, GoneError.
    """
    process = started([*command, "-v", "-o", str(target), str(source)])
    shown = []
    with process:
        assert process.stdout is not None
        threading.Thread(target=_end_if_gone, args=(process, is_gone), daemon=True).start()
        for line in process.stdout:
            logged = LOG.match(line)
            if logged is None:
                shown.append(line.rstrip().replace(str(source), name))
            elif done := PERCENT.match(logged["text"]):
                interface.progress(f"being converted, {done['percent']} done")
        status = process.wait()
    if is_gone():
        raise GoneError
    if status != 0:
        raise FailureError(" ".join(shown[-1:]) or f"hframe-post ended with status {status}")
    ours = f"{name}: "
    if shown and shown[0].startswith(ours):
        return shown[0].removeprefix(ours), False
    return "\n".join(["converted", *shown]), True


def said(command: Sequence[str], seconds: float) -> list[str]:
    """Run another command of hframe-post; return what it printed. Raises FailureError."""
    process = started(command)
    limit = threading.Timer(seconds, process.kill)
    limit.start()
    with process:
        assert process.stdout is not None
        lines = [line.rstrip() for line in process.stdout]
        status = process.wait()
    limit.cancel()
    if status < 0:
        raise FailureError(f"hframe-post {command[-1]} took more than {seconds:.0f} s")
    if status != 0:
        raise FailureError(" ".join(lines[-1:]) or f"hframe-post ended with status {status}")
    return lines


def started(command: Sequence[str]) -> subprocess.Popen[str]:
    """Start hframe-post, which ends when its standard input closes. Raises FailureError."""
    try:
        return subprocess.Popen(
            command, text=True, errors="replace",
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            env={**os.environ, "HFRAME_POST_CHILD": "1"},
        )  # fmt: skip
    except OSError as error:
        raise FailureError(
            f"{command[0]} cannot be run: {error.strerror}. Correct command in [{NAME}] of "
            "moonraker.conf"
        ) from None


def _end_if_gone(process: subprocess.Popen[str], is_gone: Callable[[], bool]) -> None:
    """End a conversion, by closing its standard input, if the user deletes the file."""
    while process.poll() is None:
        if is_gone() and process.stdin is not None:
            process.stdin.close()
            return
        time.sleep(WATCH)
