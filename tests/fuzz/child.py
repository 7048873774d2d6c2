"""A check in a child process: time and memory are limited, and nothing of it remains.

The child is a fork of a process that has loaded everything, so it starts at once.
"""

from __future__ import annotations

import os
import resource
import signal
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

MAX_SECONDS = 60  # of processor time; prints of an hour take a second or two
TIMEOUT = 600  # s by the clock, on a machine with other work
MAX_BYTES = 130 << 20  # in addition to the parent process with everything loaded: some 70 MB


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a check: a word; the defect, if any; processor time (s) and memory (bytes)."""

    word: str
    defect: str = ""
    seconds: float = 0.0
    memory: int = 0


def run_in_child(check: Callable[[], str]) -> Outcome:
    """Run a check. Neither this process nor the check may depend on threads."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        _check(check, writing)
    os.close(writing)
    with open(reading, "rb") as file:
        shared = int(file.readline())  # bytes of pages shared with this process
        text = file.read().decode("utf-8", "replace")
    _, status, used = os.wait4(child, 0)
    seconds, memory = used.ru_utime + used.ru_stime, max(used.ru_maxrss * 1024 - shared, 0)
    if os.WIFSIGNALED(status):
        text = f"!killed by {signal.Signals(os.WTERMSIG(status)).name} after {seconds:.0f} s"
    elif not text:
        text = f"!exited by itself with status {os.waitstatus_to_exitcode(status)}"
    elif memory > MAX_BYTES and not text.startswith("!"):
        text = f"!used {memory >> 20} MB ({text})"
    if text.startswith("!"):
        return Outcome("DEFECT", text[1:], seconds, memory)
    return Outcome(text, "", seconds, memory)


def _check(check: Callable[[], str], writing: int) -> None:
    """Run the check in the child process, and exit."""
    resource.setrlimit(resource.RLIMIT_CPU, (MAX_SECONDS, MAX_SECONDS + 5))
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(TIMEOUT)
    os.write(writing, b"%d\n" % _resident())
    try:
        text = check()
    except BaseException:
        text = "!" + traceback.format_exc(limit=-5)
    data = text.encode("utf-8", "backslashreplace")
    while data:
        data = data[os.write(writing, data) :]
    os._exit(0)


def _resident() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
