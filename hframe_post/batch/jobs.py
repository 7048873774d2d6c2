"""The files of a batch, and their conversion in processes of their own.

What happens to one file (a crash, lack of memory) cannot affect another, and the bytes are those
of a single conversion.
"""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any, Literal, Protocol

from hframe_post.errors import HframeError, install_advice
from hframe_post.process import ChildProcess, own_command, processor_count

State = Literal["waiting", "running", "done", "skipped", "failed"]


@dataclass(frozen=True, slots=True)
class Job:
    """A file to convert and its state.

    seconds: duration; error: one line; summary: the JSON summary of ``convert``; worker: address
    of the cluster's worker that converted it.
    """

    source: Path
    target: Path
    state: State = "waiting"
    seconds: float = 0.0
    error: str = ""
    summary: dict[str, Any] = field(default_factory=dict)
    worker: str = ""

    @property
    def finished(self) -> bool:
        return self.state not in ("waiting", "running")

    def as_json(self) -> dict[str, Any]:
        entries = {
            "source": str(self.source), "target": str(self.target), "state": self.state,
            "seconds": round(self.seconds, 3), "worker": self.worker, "error": self.error,
            "summary": self.summary,
        }  # fmt: skip
        return {name: value for name, value in entries.items() if value not in ("", {})}

    def as_text(self) -> str:
        line = f"{self.state:8s}{self.source}"
        if self.error:
            return f"{line}: {self.error}"
        return f"{line} → {self.target} ({self.seconds:.1f} s{self._contour_error()})"

    def _contour_error(self) -> str:
        """Return the predicted errors without and with compensation, µm RMS, as text."""
        errors = self.summary.get("contour_error_um", {})
        names = ("none", self.summary.get("compensation"))
        values = [errors[name]["rms"] for name in names if name in errors]
        if len(values) < 2:
            return ""
        return f"; contour error {values[-1]:.1f} µm instead of {values[0]:.0f}, predicted"


def jobs_for(sources: Sequence[Path], folder: Path, first_line: bytes) -> list[Job]:
    """Return one job per file; those converted already are marked as skipped.

    first_line: the first line of a file converted with the same settings; empty: skip none.
    Raises HframeError where a target would be written twice or replace a source.
    """
    jobs, taken = [], {path.resolve() for path in sources}
    for source in dict.fromkeys(sources):
        target = folder / source.name
        if target.resolve() in taken:
            raise HframeError(
                f"{target} would be written twice, or replace an input file: rename the input, or "
                "choose another --directory"
            )
        taken.add(target.resolve())
        done = (
            first_line
            and target.is_file()
            and target.stat().st_mtime >= source.stat().st_mtime
            and _begins_with(target, first_line)
        )
        jobs.append(Job(source, target, "skipped" if done else "waiting"))
    return jobs


def _begins_with(path: Path, first_line: bytes) -> bool:
    with path.open("rb") as file:
        return file.readline(len(first_line) + 1) == first_line


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a conversion ended: exit status (-n: signal n), its outputs, and seconds."""

    status: int
    output: bytes
    error: bytes
    seconds: float

    def update(self, job: Job) -> Job:
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


class Conversion(ChildProcess):
    """A running ``hframe-post convert`` with these options."""

    def __init__(self, source: str, target: str, options: Sequence[str]) -> None:
        self._start = time.monotonic()
        command = [*own_command(), "convert", source, "-o", target, "-q", "--json", "-", *options]
        super().__init__(command)

    def outcome(self) -> Outcome:
        """Wait for the end."""
        return Outcome(*self.wait(), time.monotonic() - self._start)


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
        outcome = conversion.outcome()
        self._running.discard(conversion)
        return outcome.update(job)

    def stop(self) -> None:
        self._stopped = True
        for conversion in list(self._running):
            conversion.stop()


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


# ---------------------------------------------------------------------- a watched folder

SUFFIXES = (".gcode", ".gco", ".g")
UPLOAD_PAUSE = 2.0  # s without a change after which an upload counts as complete


def watch_folder(watched: Path, folder: Path, first_line: bytes) -> Iterator[list[Job]]:
    """Yield lists of files to convert, until interrupted.

    The caller converts each list in place before it asks for the next: a file that failed is not
    tried again until it changes. Raises HframeError where the package watchfiles is missing.
    """
    try:
        from watchfiles import watch
    except ImportError:
        raise HframeError(
            f"--watch needs watchfiles. Install it with: {install_advice('watchfiles')}"
        ) from None

    failed: dict[Path, tuple[int, int]] = {}
    for _ in watch(watched, recursive=False, yield_on_timeout=True, rust_timeout=1000,
                   raise_interrupt=False):  # fmt: skip
        found = [
            path
            for path in sorted(watched.iterdir())
            if _is_complete_gcode(path) and failed.get(path) != _version(path)
        ]
        jobs = [job for job in jobs_for(found, folder, first_line) if not job.finished]
        if jobs:
            yield jobs
        failed |= {job.source: _version(job.source) for job in jobs if job.state == "failed"}


def _is_complete_gcode(path: Path) -> bool:
    if path.suffix.lower() not in SUFFIXES or path.name.startswith(".") or not path.is_file():
        return False
    return time.time() - _version(path)[0] / 1e9 >= UPLOAD_PAUSE


def _version(path: Path) -> tuple[int, int]:
    try:
        status = path.stat()
    except OSError:  # deleted in the meantime
        return 0, 0
    return status.st_mtime_ns, status.st_size
