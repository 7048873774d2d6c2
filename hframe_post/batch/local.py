"""Conversion of a file in a process of its own.

What happens to one file (a crash, lack of memory) cannot affect another, and the bytes are those
of a single conversion.
"""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from hframe_post.batch.job import Job
from hframe_post.process import ChildProcess, own_command, processor_count


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a conversion ended: exit status (-n: signal n), its outputs, and seconds."""

    status: int
    output: bytes
    error: bytes
    seconds: float

    def update(self, job: Job) -> Job:
        """Return the job as done or failed."""
        if self.status == 0:
            return replace(job, state="done", seconds=self.seconds, summary=json.loads(self.output))
        return replace(job, state="failed", seconds=self.seconds, error=self._cause())

    def _cause(self) -> str:
        lines = self.error.decode("utf-8", "replace").strip().splitlines()
        if lines:
            return lines[-1].removeprefix("Error: ")
        if self.status < 0:
            return f"killed by {signal.Signals(-self.status).name}"
        return f"exit status {self.status}"


class Conversion:
    """A running ``hframe-post convert`` with these options."""

    def __init__(self, source: str, target: str, options: Sequence[str]) -> None:
        command = [*own_command(), "convert", source, "-o", target, "-q", "--json", "-", *options]
        self._start = time.monotonic()
        self._process = ChildProcess(command)

    def wait(self) -> Outcome:
        """Wait for the end."""
        return Outcome(*self._process.wait(), time.monotonic() - self._start)

    def stop(self) -> None:
        """Ask it to end."""
        self._process.stop()


class LocalProcesses:
    """Conversion of several files at a time on this machine, which share its processors."""

    def __init__(self, files: int | None, options: Sequence[str]) -> None:
        processors = processor_count()
        self.files = files or processors
        self._options = [*options, "--jobs", str(max(processors // self.files, 1))]
        self._running: set[Conversion] = set()
        self._stopped = False

    def convert(self, job: Job) -> Job:
        """Convert one file; return its job as done or failed."""
        if self._stopped:
            return replace(job, state="failed", error="stopped")
        conversion = Conversion(str(job.source), str(job.target), self._options)
        self._running.add(conversion)
        outcome = conversion.wait()
        self._running.discard(conversion)
        return outcome.update(job)

    def stop(self) -> None:
        """Stop the running conversions and start no more."""
        self._stopped = True
        for conversion in list(self._running):
            conversion.stop()
