"""The loop that keeps a number of conversions running."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from itertools import islice
from typing import Protocol

from hframe_post.batch.job import Job


class Converter(Protocol):
    """Where files are converted, ``files`` at a time, each from a thread that waits for it."""

    @property
    def files(self) -> int: ...

    def convert(self, job: Job) -> Job:
        """Convert one file; return its job as done or failed. Raise nothing for a bad file."""

    def stop(self) -> None:
        """Start no more conversions, and stop those that are running."""


def run(jobs: list[Job], converter: Converter) -> Iterator[Job]:
    """Convert the waiting jobs; replace each in the list, and yield it, when it has ended."""
    waiting = iter([k for k, job in enumerate(jobs) if job.state == "waiting"])
    running: dict[Future[Job], int] = {}
    with ThreadPoolExecutor(converter.files) as pool:
        try:
            while True:
                for k in islice(waiting, converter.files - len(running)):
                    jobs[k] = replace(jobs[k], state="running")
                    running[pool.submit(converter.convert, jobs[k])] = k
                if not running:
                    return
                finished, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in finished:
                    k = running.pop(future)
                    jobs[k] = future.result()
                    yield jobs[k]
        except BaseException:  # the caller gave up, too
            converter.stop()
            raise
