"""All jobs, so many at a time, while a table shows how far they are."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from typing import Protocol

from hframe_post.cli.batch.job import Job
from hframe_post.cli.batch.table import shown


class Place(Protocol):
    """Where files are converted, several at a time; threads wait for one each."""

    @property
    def files(self) -> int:
        """At a time."""

    def convert(self, job: Job) -> Job:
        """The job, done or failed; nothing is raised for a file's sake."""

    def stop(self) -> None:
        """No job begins any more."""


def run(pending: list[Job], place: Place, quiet: bool) -> list[Job]:
    """All of them, in their order, once they are done."""
    done = list(pending)
    waiting = iter([k for k, job in enumerate(pending) if job.state == "waiting"])
    with shown(done, quiet) as show, ThreadPoolExecutor(place.files) as pool:
        running: dict[Future[Job], int] = {}

        def begin() -> None:
            for k in waiting:
                done[k] = replace(done[k], state="running", began=time.monotonic())
                running[pool.submit(place.convert, done[k])] = k
                if len(running) == place.files:
                    return

        try:
            begin()
            while running:
                if _finish(running, done, show):
                    begin()
                show(None)
        finally:
            place.stop()
    return done


def _finish(
    running: dict[Future[Job], int], done: list[Job], show: Callable[[Job | None], None]
) -> bool:
    """Takes what is finished, within a quarter of a second; whether anything was."""
    finished, _ = wait(running, timeout=0.25, return_when=FIRST_COMPLETED)
    for future in finished:
        k = running.pop(future)
        done[k] = future.result()
        show(done[k])
    return bool(finished)
