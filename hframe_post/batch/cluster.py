"""Conversion by the workers of a Dask cluster: https://distributed.dask.org

Files and profile are sent to a worker by content, and the result is fetched. A worker runs the
same process as this machine would, so the bytes are the same. If a worker is lost, the scheduler
gives its file to another.
"""

from __future__ import annotations

import logging
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hframe_post.batch.jobs import Conversion, Job, Outcome
from hframe_post.conversion.options import Options
from hframe_post.errors import HframeError, install_advice
from hframe_post.printer.model_file import named_model
from hframe_post.version import __version__
from hframe_post.writers.outputs import Outputs

TIMEOUT = 10  # s for the scheduler to answer, and for a worker to appear


@dataclass(frozen=True, slots=True)
class Task:
    """What a worker is sent: a file's name and content, and the options of its conversion.

    printer: the profile's name. profile: its content and that of the model that it names, by the
    names of these files; none for a shipped one.
    """

    name: str
    content: bytes
    printer: str
    profile: dict[str, bytes]
    options: Options
    version: str = __version__


@dataclass(frozen=True, slots=True)
class Result:
    """What a worker sends back; content: the converted file, empty if it failed."""

    outcome: Outcome
    worker: str
    content: bytes


def convert_on_worker(task: Task) -> Result:
    """Convert a file on a worker. Raises HframeError if the worker runs another version."""
    from distributed import get_worker

    worker = str(get_worker().address)
    if task.version != __version__:
        raise HframeError(f"worker {worker} has hframe-post {__version__}, not {task.version}")
    with tempfile.TemporaryDirectory(prefix="hframe-post-") as folder:
        source, target = Path(folder, task.name), Path(folder, "out", task.name)
        target.parent.mkdir()
        source.write_bytes(task.content)
        printer = task.printer
        if task.profile:
            Path(folder, "profile").mkdir()
            for name, content in task.profile.items():
                Path(folder, "profile", name).write_bytes(content)
            printer = str(Path(folder, "profile", Path(printer).name))
        options = replace(task.options, jobs=1)  # a worker's thread: a processor
        outcome = Conversion(source, target, printer, options).outcome()
        return Result(outcome, worker, target.read_bytes() if outcome.status == 0 else b"")


class Cluster:
    """The workers of a scheduler.

    files: how many are converted at a time, by default one per thread of the workers. first_line:
    the first line that each converted file must have. Raises HframeError if no worker answers.
    """

    def __init__(
        self, scheduler: str, files: int | None, printer: str, options: Options, first_line: bytes
    ) -> None:
        self._client = _connect(scheduler)
        self.files = files or sum(self._client.nthreads().values())
        self._printer, self._options, self._first_line = printer, options, first_line
        own = [Path(printer), *named_model(printer)] if Path(printer).is_file() else []
        self._profile = {file.name: file.read_bytes() for file in own}
        self._running: set[Any] = set()  # futures of the scheduler
        self._stopped = False

    def convert(self, job: Job) -> Job:
        """Convert one file; return its job as done, failed or stopped."""
        try:
            task = Task(
                job.source.name, job.source.read_bytes(), self._printer, self._profile,
                self._options,
            )  # fmt: skip
            running = self._client.submit(convert_on_worker, task, pure=False)
            self._running.add(running)
            if self._stopped:  # in the meantime
                running.cancel()
            try:
                result: Result = running.result()
            finally:
                self._running.discard(running)
            job = replace(result.outcome.update(job), worker=result.worker)
            if job.state == "done":
                left_alone = "left_alone" in job.summary
                if not left_alone and self._first_line not in result.content:
                    raise HframeError(f"{result.worker} converted it with other settings")
                with Outputs() as outputs:
                    outputs.open(job.target).write(result.content)
        except Exception as error:  # whatever happened to this file, the others go on
            if self._stopped:
                return replace(job, state="stopped")
            return replace(job, state="failed", error=_cause(error))
        return job

    def stop(self) -> None:
        """Cancel all conversions; those that a worker has begun end there, unread."""
        self._stopped = True
        for running in list(self._running):
            running.cancel()


def _connect(scheduler: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise HframeError(
            "--scheduler needs dask.distributed. Install it with: " + install_advice("distributed")
        ) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # errors are reported once, by us
    try:
        client: Any = Client(  # type: ignore[no-untyped-call]
            scheduler, timeout=TIMEOUT, set_as_default=False
        )
        client.wait_for_workers(1, timeout=TIMEOUT)
    except (OSError, ValueError) as error:
        raise HframeError(
            f"{scheduler}: no cluster with a worker answers ({error}); start one with "
            "'dask scheduler' and 'dask worker'"
        ) from None
    return client


def _cause(error: Exception) -> str:
    if type(error).__name__ == "KilledWorker":
        return "every worker that tried it was killed: is there enough memory?"
    if isinstance(error, ModuleNotFoundError):
        return f"the worker's Python lacks a package: {error}"
    return " ".join(str(error).split()) or type(error).__name__
