"""hframe-post as a process: its conversion of a file, and its other commands."""

from __future__ import annotations

import json
import os
import re
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .disk import NAME, BeyondError, FailureError, GoneError
from .interface import Interface

LOG = re.compile(r"\s*\d+\.\d{3} s  (?P<text>.*)")  # of hframe-post -v
PERCENT = re.compile(r"(?P<percent>\d+ %) is read")
SHORT = re.compile(  # also for the stack of a thread
    r"(not enough|lack of|cannot allocate) memory|memory allocation|start new thread", re.IGNORECASE
)
WATCH = 0.3  # s between two looks whether the user has deleted the file
ELSEWHERE = "Convert it on another computer, then upload it again"
LONGEST = 2.0  # hours that a conversion may take


def converted(
    source: Path, target: Path, name: str, command: Sequence[str], interface: Interface,
    is_gone: Callable[[], bool],
) -> tuple[str, Mapping[str, Any] | None]:  # fmt: skip
    """Convert a file; return the summary as text and as JSON, None if nothing was to be converted.

    name: of the source for people. is_gone: whether the user has deleted the file meanwhile. The
    JSON is empty if the command writes its own. Raises FailureError with the reason, BeyondError,
    GoneError.
    """
    summary = target.with_suffix(".json.new")  # which tidying removes if this is killed
    written = [] if "--json" in command else ["--json", str(summary)]
    process = started([*command, *written, "-v", "-o", str(target), str(source)])
    deadline = time.monotonic() + 3600.0 * LONGEST
    try:
        shown, status = _followed(
            process, interface, lambda: is_gone() or time.monotonic() > deadline
        )
        found = json.loads(summary.read_text("utf-8")) if summary.exists() else {}
    finally:
        summary.unlink(missing_ok=True)
    shown = [line.replace(str(source), name) for line in shown]
    if is_gone():
        raise GoneError
    if status != 0:
        reason = " ".join(shown[-1:])
        if time.monotonic() > deadline:
            raise BeyondError(f"its conversion takes more than {LONGEST:g} hours. {ELSEWHERE}")
        if SHORT.search(reason):
            raise BeyondError(f"its conversion takes more memory than it may. {ELSEWHERE}")
        if status < 0:
            raise BeyondError(f"its conversion was killed, perhaps for lack of memory. {ELSEWHERE}")
        raise FailureError(reason or f"hframe-post ended with status {status}")
    ours = f"{name}: "
    if shown and shown[0].startswith(ours):
        return shown[0].removeprefix(ours), None
    return "\n".join(["converted", *shown]), found


def _followed(
    process: subprocess.Popen[str], interface: Interface, is_over: Callable[[], bool]
) -> tuple[list[str], int]:
    """Report the progress of a conversion; return what else it printed and its exit status."""
    shown = []
    with process:
        assert process.stdout is not None
        threading.Thread(target=_end_if_over, args=(process, is_over), daemon=True).start()
        for line in process.stdout:
            logged = LOG.match(line)
            if logged is None:
                shown.append(line.rstrip())
            elif done := PERCENT.match(logged["text"]):
                interface.progress(f"being converted, {done['percent']} done")
        return shown, process.wait()


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


def _end_if_over(process: subprocess.Popen[str], is_over: Callable[[], bool]) -> None:
    """End a conversion, by closing its standard input, if nobody wants it any more."""
    while process.poll() is None:
        if is_over() and process.stdin is not None:
            process.stdin.close()
            return
        time.sleep(WATCH)
