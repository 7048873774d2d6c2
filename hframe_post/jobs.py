"""The files of a batch, and their conversion in processes of their own.

What happens to one file (a crash, lack of memory) cannot affect another, and the bytes are those
of a single conversion.
"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
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

    @property
    def warnings(self) -> list[str]:
        found: list[str] = self.summary.get("warnings", [])
        return found

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


def with_targets(
    sources: Iterable[Path], folder: Path
) -> tuple[list[tuple[Path, Path]], list[Path]]:
    """Return the files to convert, each with its target in ``folder``, and packed ones left out.

    Of a folder these are the files of G-code in it and its subfolders, whose structure is kept.
    Raises HframeError for a folder without G-code, and OSError for one that cannot be read.
    """
    found: list[tuple[Path, Path]] = []
    packed = list[Path]()
    for source in sources:
        if not source.is_dir():
            if _is_packed(source.name):
                raise HframeError(f"{source} is packed: unpack it first, with gunzip")
            found.append((source, folder / source.name))
            continue
        files = _gcode_in(source, folder, packed, _raise)
        if not files:
            only = f"only {packed[0].name}: unpack it first" if packed else ", ".join(NAMES)
            raise HframeError(f"{source} holds no G-code ({only})")
        found += [(path, folder / path.relative_to(source)) for path in files]
    return list(dict.fromkeys(found)), packed


def _is_packed(name: str) -> bool:
    return name.lower().endswith(".gz") and is_gcode_name(name[: -len(".gz")])


def _gcode_in(
    folder: Path, without: Path, packed: list[Path], on_error: Callable[[OSError], object]
) -> list[Path]:
    """Return the files of G-code in a folder and its subfolders, without hidden ones.

    without: a subfolder that is left out, too: the one of the output. packed: gets those that are
    compressed.
    """
    found, left_out = [], without.resolve()
    for place, folders, names in os.walk(folder, onerror=on_error):
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".") and Path(place, name).resolve() != left_out
        )
        shown = [name for name in sorted(names) if name[0] != "."]
        found += [Path(place, name) for name in shown if is_gcode_name(name)]
        packed += [Path(place, name) for name in shown if _is_packed(name)]
    return found


def _raise(error: OSError) -> None:
    raise error


def jobs_for(files: Sequence[tuple[Path, Path]], first_line: bytes) -> list[Job]:
    """Return one job per file and target; those converted already are marked as skipped.

    first_line: that of a file converted with the same settings; empty: skip none.
    Raises HframeError where a target would be written twice or replace a source.
    """
    jobs, taken = [], dict[Path, Path]()
    inputs = {source.resolve(): source for source, _ in files}
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


def _has(path: Path, first_line: bytes) -> bool:
    """Return whether a file has the line, maybe behind previews that come first."""
    with path.open("rb") as file:
        return (b"\n" + first_line) in b"\n" + file.read(MOST_COMMENTS)
