"""Conversions by processes on this machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hframe_post.cli.batch.job import Job
from hframe_post.cli.batch.one_file import Conversion
from hframe_post.cli.process import processors


class LocalProcesses:
    """So many files at a time; processors that are left over are shared among them."""

    def __init__(self, files: int | None, options: Sequence[str]) -> None:
        self.files = files or processors()
        each = max(processors() // self.files, 1)
        self._options = [*options, "--jobs", str(each)]
        self._running: set[Conversion] = set()
        self._stopped = False

    def convert(self, job: Job) -> Job:
        """The job, done or failed."""
        if self._stopped:
            return replace(job, state="failed", error="stopped")
        conversion = Conversion(str(job.source), str(job.target), self._options)
        self._running.add(conversion)
        ended = conversion.ended()
        self._running.discard(conversion)
        return ended.of(job)

    def stop(self) -> None:
        """None begins any more, and those that run end."""
        self._stopped = True
        for conversion in list(self._running):
            conversion.stop()
