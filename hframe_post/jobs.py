"""The files of a batch, and their conversion in processes of their own.

What happens to one file (a crash, lack of memory) cannot affect another, and the bytes are those
of a single conversion.
"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, Literal

from hframe_post.conversion.options import Options
from hframe_post.errors import HframeError
from hframe_post.gcode.lines import NAMES, is_gcode_name
from hframe_post.process import ChildProcess, own_command, processor_count

State = Literal["waiting", "done", "skipped", "failed", "stopped"]
INTERRUPTS = [  # that a terminal sends to all processes of a job
    getattr(signal, name) for name in ("SIGINT", "SIGHUP", "SIGQUIT") if hasattr(signal, name)
]


@dataclass(frozen=True, slots=True)
class Job:
    """A file to convert and its state.

    seconds: duration; error: one line; line: the one in the source that it names; summary: the
    JSON summary of ``convert``.
    """

    source: Path
    target: Path
    state: State = "waiting"
    seconds: float = 0.0
    error: str = ""
    line: int | None = None
    summary: dict[str, Any] = field(default_factory=dict)

    @property
    def finished(self) -> bool:
        return self.state != "waiting"

    def as_json(self) -> dict[str, Any]:
        entries = {
            "source": str(self.source), "target": str(self.target), "state": self.state,
            "seconds": round(self.seconds, 3), "error": self.error,
            "line": self.line, "summary": self.summary,
        }  # fmt: skip
        return {name: value for name, value in entries.items() if value not in ("", None, {})}

    def as_text(self) -> str:
        line = f"{self.state:8s}{self.source}"
        if self.state == "stopped":
            return line
        if self.error:
            return f"{line}: {self.error}"
        if "left_alone" in self.summary:
            return f"{line} → {self.target}, not converted: {self.summary['left_alone']}"
        return f"{line} → {self.target} ({self.seconds:.1f} s{self._contour_error()})"

    def _contour_error(self) -> str:
        """Return the predicted errors without and with compensation, µm RMS, as text."""
        errors = self.summary.get("contour_error_um", {})
        names = ("none", self.summary.get("compensation"))
        found = [errors[name] for name in names if name in errors]
        if len(found) < 2:
            return ""
        none, ours = found[0], found[-1]
        text = f"; ringing {none['rms']:.1f} → {ours.get('median', ours['rms']):.1f} µm"
        if "to" in ours:
            text += f" (up to {ours['to']:.1f} as the printer changes)"
        return text


class Converter:
    """Converts several files at a time, which share this machine's processors."""

    def __init__(self, files: int | None, printer: str, options: Options) -> None:
        processors = processor_count()
        self.files = files or processors
        each = replace(options, jobs=max(processors // self.files, 1))
        self._words = "-q", "--json", "-", "-p", printer, *each.words()
        self._running = set[ChildProcess]()
        self._stopped = False

    def run(self, jobs: list[Job]) -> Iterator[Job]:
        """Convert the waiting jobs; replace each in the list, and yield it, when it has ended.

        Those that have not begun when it is stopped become ``stopped`` and are not yielded.
        """
        with ThreadPoolExecutor(self.files) as pool:
            waiting = (k for k, job in enumerate(jobs) if job.state == "waiting")
            places = {pool.submit(self._converted, jobs[k]): k for k in waiting}
            try:
                for future in as_completed(places):
                    k, ended = places[future], future.result()
                    jobs[k] = ended or replace(jobs[k], state="stopped")
                    if ended is not None:
                        yield ended
            except BaseException:  # the caller gave up, too
                self.stop()
                raise

    def stop(self) -> None:
        """Start no more conversions, and stop those that are running."""
        self._stopped = True
        for child in list(self._running):
            child.stop()

    def _converted(self, job: Job) -> Job | None:
        """Convert one file; return the job as it ended, None if it did not begin."""
        if self._stopped:
            return None
        try:
            job.target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            return replace(job, state="failed", error=f"{job.target.parent}: {error.strerror}")
        began, files = time.monotonic(), ("-o", str(job.target), "--", str(job.source))
        child = ChildProcess([*own_command(), "convert", *self._words, *files])
        self._running.add(child)
        if self._stopped:  # in the meantime
            child.stop()
        status, output, said = child.wait()
        self._running.discard(child)
        job = replace(job, seconds=time.monotonic() - began)
        if status == 0:
            return replace(job, state="done", summary=json.loads(output))
        if self._stopped or -status in INTERRUPTS:
            return replace(job, state="stopped")
        try:
            failure = json.loads(output)
        except ValueError:  # killed before it could say anything
            failure = {}
        cause = failure.get("error") or _cause(status, said.decode("utf-8", "replace"))
        return replace(job, state="failed", error=cause, line=failure.get("line"))


def _cause(status: int, said: str) -> str:
    """Return why a conversion failed. status: of its exit, or -n for a signal n."""
    if lines := said.strip().splitlines():
        return lines[-1].removeprefix("Error: ")
    return f"killed by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"


# ----------------------------------------------------------------------
# Which files a batch converts: those that are named, and those in folders.

MOST_COMMENTS = 1 << 20  # bytes; previews may precede the first line of ours


def jobs_for(sources: Iterable[Path], folder: Path, first_line: bytes = b"") -> list[Job]:
    """Return one job per file, with its target in ``folder``.

    Of a folder these are the files of G-code in it and its subfolders, whose structure is kept.
    first_line: that of a file converted with the same settings, which is marked as skipped; empty:
    skip none. Raises HframeError for a folder without G-code and where a target would be written
    twice or replace a source, and OSError for a folder that cannot be read.
    """
    files = dict.fromkeys(chain.from_iterable(_with_targets(each, folder) for each in sources))
    inputs = {source.resolve(): source for source, _ in files}
    jobs, taken = [], dict[Path, Path]()
    for source, target in files:
        place = target.resolve()
        if place in inputs:
            raise HframeError(
                f"{target} would replace the input {inputs[place]}: choose another --output"
            )
        if place in taken:
            raise HframeError(
                f"{taken[place]} and {source} would both be written to {target}: rename one, or "
                "name a folder that holds both, whose subfolders are kept"
            )
        taken[place] = source
        done = (
            first_line
            and target.is_file()
            and target.stat().st_mtime >= source.stat().st_mtime
            and _has(target, first_line)
        )
        jobs.append(Job(source, target, "skipped" if done else "waiting"))
    return jobs


def _with_targets(source: Path, folder: Path) -> Iterator[tuple[Path, Path]]:
    """Yield a file, or those of G-code in a folder, each with its target in ``folder``.

    Hidden ones are left out, and those in ``folder``.
    """
    if not source.is_dir():
        yield source, folder / source.name
        return
    found, left_out = False, folder.resolve()
    for place, folders, names in os.walk(source, onerror=_raise):
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".") and Path(place, name).resolve() != left_out
        )
        for name in sorted(names):
            if is_gcode_name(name) and not name.startswith("."):
                found, path = True, Path(place, name)
                yield path, folder / path.relative_to(source)
    if not found:
        raise HframeError(f"{source} holds no G-code ({', '.join(NAMES)})")


def _raise(error: OSError) -> None:
    raise error


def _has(path: Path, first_line: bytes) -> bool:
    """Return whether a file has the line, maybe behind previews that come first."""
    with path.open("rb") as file:
        return (b"\n" + first_line) in b"\n" + file.read(MOST_COMMENTS)
