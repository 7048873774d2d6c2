"""A check in a process of its own: what it uses is bounded, and nothing of it stays.

The process is a copy of one that has everything loaded, so it begins at once.
"""

from __future__ import annotations

import os
import resource
import signal
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

SECONDS = 60  # of processor time, for prints of an hour or less: they take a second or two
WAITED = 600  # s by the clock, on a machine with other work: nothing waits for ever
BYTES = 130 << 20  # beyond what a process with everything loaded has: some 70 MB


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a check: a word; the defect, if any; processor time (s) and memory (bytes)."""

    word: str
    defect: str = ""
    seconds: float = 0.0
    memory: int = 0


def apart(check: Callable[[], str]) -> Outcome:
    """Runs it. Neither this process nor the check may have threads that matter to it."""
    told, tell = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(told)
        _check(check, tell)
    os.close(tell)
    with open(told, "rb") as file:
        held = int(file.readline())  # of pages that it shares with this process
        text = file.read().decode("utf-8", "replace")
    _, status, used = os.wait4(child, 0)
    seconds, memory = used.ru_utime + used.ru_stime, max(used.ru_maxrss * 1024 - held, 0)
    if os.WIFSIGNALED(status):
        text = f"!killed by {signal.Signals(os.WTERMSIG(status)).name} after {seconds:.0f} s"
    elif not text:
        text = f"!ended by itself, with status {os.waitstatus_to_exitcode(status)}"
    elif memory > BYTES and not text.startswith("!"):
        text = f"!{memory >> 20} MB ({text})"
    if text.startswith("!"):
        return Outcome("DEFECT", text[1:], seconds, memory)
    return Outcome(text, "", seconds, memory)


def _check(check: Callable[[], str], tell: int) -> None:
    """In the copy, which does not return."""
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(WAITED)
    os.write(tell, b"%d\n" % _resident())
    try:
        text = check()
    except BaseException:
        text = "!" + traceback.format_exc(limit=-5)
    data = text.encode("utf-8", "backslashreplace")
    while data:
        data = data[os.write(tell, data) :]
    os._exit(0)


def _resident() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
