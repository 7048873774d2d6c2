"""One file converted by a process of its own.

So nothing that happens to one file (not enough memory, a crash) can happen to another, and the
bytes are those of a single conversion. The process ends with the one that started it.
"""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from hframe_post.cli.batch.job import Job
from hframe_post.cli.leash import Leashed
from hframe_post.cli.process import itself


@dataclass(frozen=True, slots=True)
class Ended:
    """How a process ended: exit status (below 0: a signal), what it said, and seconds."""

    status: int
    told: bytes
    error: bytes
    seconds: float

    def of(self, job: Job) -> Job:
        """The job, done or failed."""
        if self.status == 0:
            return replace(job, state="done", seconds=self.seconds, summary=json.loads(self.told))
        return replace(job, state="failed", seconds=self.seconds, error=self._cause())

    def _cause(self) -> str:
        """A line of what it said, or how it ended without a word."""
        lines = self.error.decode("utf-8", "replace").strip().splitlines()
        if lines:
            return lines[-1].removeprefix("Error: ")
        if self.status < 0:
            return f"killed by {signal.Signals(-self.status).name}"
        return f"exit status {self.status}"


class Conversion:
    """A process that converts a file, with these options of ``convert``."""

    def __init__(self, source: str, target: str, options: Sequence[str]) -> None:
        command = [*itself(), "convert", source, "-o", target, "-q", "--json", "-", *options]
        self._began = time.monotonic()
        self._process = Leashed(command)

    def ended(self) -> Ended:
        """Waits for its end."""
        return Ended(*self._process.ended(), time.monotonic() - self._began)

    def stop(self) -> None:
        """Asks it to end; it leaves nothing behind."""
        self._process.stop()
