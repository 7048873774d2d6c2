"""Processes that end with the one that started them, however that one ends, and tidily.

The standard input of such a process is a pipe to which nobody writes. Its other end is held by
the parent alone, so it closes when the parent is no more.
"""

from __future__ import annotations

import os
import subprocess  # nosec B404  only this tool itself is started
import threading
import time
from collections.abc import Sequence

from hframe_post.writers.files.temporary import give_up

VARIABLE = "HFRAME_POST_LEASH"  # in the environment of a process whose input is such a pipe
MOMENT = 0.01  # s


class Leashed:
    """A process of this tool, its two outputs piped, that ends with this one."""

    def __init__(self, command: Sequence[str]) -> None:
        slack, self._held = os.pipe()
        try:
            self._process = subprocess.Popen(  # nosec B603  no shell, a list
                command, stdin=slack, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                env={**os.environ, VARIABLE: "1"},
            )  # fmt: skip
        finally:
            os.close(slack)

    def ended(self) -> tuple[int, bytes, bytes]:
        """Waits for its end: exit status (below 0: a signal) and what it wrote."""
        try:
            told, error = self._process.communicate()
            return self._process.returncode, told, error
        finally:
            os.close(self._held)

    def stop(self) -> None:
        """Asks it to end; it leaves nothing behind."""
        self._process.terminate()


def end_with_parent() -> None:
    """If this process was started so."""
    if os.environ.get(VARIABLE):
        threading.Thread(target=_wait, daemon=True).start()


def _wait() -> None:
    os.read(0, 1)  # nothing, and only once the parent has gone
    while not give_up():  # files that are appearing at this moment do so first
        time.sleep(MOMENT)
    os._exit(1)
