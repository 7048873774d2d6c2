"""``hframe-post batch``: convert many files, each in a process of its own.

What happens to one file (a crash, lack of memory) cannot affect another, and the bytes are those
of a single conversion.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import click

from hframe_post.cli.parameters import FOLDER, Summary, chosen_printer, files_read, say, shared
from hframe_post.conversion.options import Options, first_line
from hframe_post.errors import HframeError
from hframe_post.gcode.lines import NAMES, is_gcode_name
from hframe_post.printer.profile import check_identified, load
from hframe_post.process import ChildProcess, Interruption, own_command, processor_count
from hframe_post.writers.outputs import Outputs

State = Literal["waiting", "done", "skipped", "failed", "stopped"]
CLEAR_LINE = "\r\x1b[K"
INTERRUPTS = [  # that a terminal sends to all processes of a job
    getattr(signal, name) for name in ("SIGINT", "SIGHUP", "SIGQUIT") if hasattr(signal, name)
]


@click.command()
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True),
                metavar="[FILE|FOLDER]...")  # fmt: skip
@click.option(
    "-o", "--output", "folder", required=True, type=FOLDER, metavar="FOLDER",
    help="Folder for the converted files.",
)  # fmt: skip
@click.option(
    "-j", "--jobs", type=click.IntRange(1, 256), metavar="N",
    help="Files at a time. Default: one per processor.",
)  # fmt: skip
@shared("printer", "strategy", "limits", "clamp", "force")
@click.option("--resume", is_flag=True, help="Skip files that are converted already.")
@shared("json", "help_all", "quiet")
@click.pass_context
def batch(
    context: click.Context, sources: tuple[Path, ...], folder: Path, jobs: int | None,
    printer: str, options: Options, resume: bool,
    summary: Summary, quiet: bool,
) -> None:  # fmt: skip
    """Convert files, and all G-code in folders. A file that fails does not stop the others.

    --resume skips files that were converted with the same settings and have not changed since.
    Exit status: 0 if every file is converted, 1 if some failed, 2 for wrong usage.

    \b
    Examples:
      hframe-post batch jobs/ -o out/
      hframe-post batch jobs/*.gcode -o out/ -p my.toml --resume
    """
    profile = load(printer)
    resolved = options.resolved(profile)
    compensates = resolved.strategy != "none"
    if compensates and not options.force:
        check_identified(profile)
    try:
        todo = jobs_for(sources, folder, first_line(profile, resolved) if resume else b"")
    except HframeError as error:
        raise click.UsageError(str(error)) from None
    folder.mkdir(parents=True, exist_ok=True)
    converter, interruption = Converter(jobs, printer, options), Interruption()
    notices = profile.warnings() if compensates else []  # which every file has
    tell = (lambda _: None) if quiet else say
    for text in notices:
        tell(f"WARNING {text}")
    with Outputs(files_read(*(job.source for job in todo), printer)) as outputs:
        summary.open(outputs)
        with interruption.put_off(converter.stop):
            _convert(todo, converter, quiet)
        status = 0 if all(job.state in ("done", "skipped") for job in todo) else 1
        if interruption.number:
            status = 128 + interruption.number
        files = [job.as_json(chosen_printer().why) for job in todo]
        failed = sum(job.state == "failed" for job in todo)
        found = {"files": files, "failed": failed, "interrupted": bool(interruption.number)}
        summary.write(found, status)
    tell(_summary(todo, notices))
    interruption.end()
    context.exit(status)


def _convert(jobs: Sequence[Job], converter: Converter, quiet: bool) -> None:
    """Convert the jobs; print each result, below them a progress bar on a terminal."""
    sizes = {job.source: 0 if job.finished else job.source.stat().st_size for job in jobs}
    terminal = sys.stderr.isatty()

    def count(_: Job | None) -> str:
        return f"{sum(job.finished for job in jobs)} of {len(jobs)}"

    with click.progressbar(
        length=sum(sizes.values()), file=sys.stderr, hidden=quiet or not terminal,
        item_show_func=count,
    ) as bar:  # fmt: skip
        for job in converter.run(jobs):
            if not quiet:
                say(CLEAR_LINE * terminal + job.as_text())
            bar.update(sizes[job.source], job)


def _summary(jobs: Sequence[Job], notices: Sequence[str]) -> str:
    """Return what needs attention, each with its files, and the counts in the last line."""
    warned: dict[str, list[Path]] = {}
    for job in jobs:
        for text in job.summary.get("warnings", []):
            if text not in notices:
                warned.setdefault(text, []).append(job.source)
    count = Counter(job.state for job in jobs)
    lines = list[str]()
    if len(jobs) > 1:
        lines = [job.as_text() for job in jobs if job.state == "failed"]
        lines += [f"WARNING {_some(files)}: {text}" for text, files in warned.items()]
    counts = f"{count['done']} converted, {count['skipped']} skipped, {count['failed']} failed"
    if warned:
        counts += f", {len(set(chain(*warned.values())))} with warnings"
    if count["stopped"]:
        counts += f", {count['stopped']} not converted"
    if count["failed"] or count["stopped"]:
        counts += "; --resume tries only those again"
    return "\n".join([*lines, counts])


def _some(files: list[Path]) -> str:
    more = f" and {len(files) - 3} more" if len(files) > 3 else ""
    return ", ".join(map(str, files[:3])) + more


# ---------------------------------------------------------------------- conversions


@dataclass(slots=True)
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

    def as_json(self, chosen_by: str) -> dict[str, Any]:
        """Return what there is to say of it. chosen_by: what chose the profile, here a -p."""
        if self.summary:
            self.summary["profile_chosen_by"] = chosen_by
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

    def run(self, jobs: Iterable[Job]) -> Iterator[Job]:
        """Convert the waiting jobs; yield each when it has ended.

        Those that have not begun when it is stopped become ``stopped`` and are not yielded.
        """
        with ThreadPoolExecutor(self.files) as pool:
            futures = {pool.submit(self._convert, job): job for job in jobs if not job.finished}
            try:
                for future in as_completed(futures):
                    if future.result():
                        yield futures[future]
            except BaseException:  # the caller gave up, too
                self.stop()
                raise

    def stop(self) -> None:
        """Start no more conversions, and stop those that are running."""
        self._stopped = True
        for child in list(self._running):
            child.stop()

    def _convert(self, job: Job) -> bool:
        """Convert one file; return whether it began."""
        if self._stopped:
            job.state = "stopped"
            return False
        try:
            job.target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            job.state, job.error = "failed", f"{job.target.parent}: {error.strerror}"
            return True
        began, files = time.monotonic(), ("-o", str(job.target), "--", str(job.source))
        child = ChildProcess([*own_command(), "convert", *self._words, *files])
        self._running.add(child)
        if self._stopped:  # in the meantime
            child.stop()
        status, output, said = child.wait()
        self._running.discard(child)
        job.seconds = time.monotonic() - began
        if status == 0:
            job.state, job.summary = "done", json.loads(output)
        elif self._stopped or -status in INTERRUPTS:
            job.state = "stopped"
        else:
            try:
                failure = json.loads(output)
            except ValueError:  # killed before it could say anything
                failure = {}
            cause = failure.get("error") or _cause(status, said.decode("utf-8", "replace"))
            job.state, job.error, job.line = "failed", cause, failure.get("line")
        return True


def _cause(status: int, said: str) -> str:
    """Return why a conversion failed. status: of its exit, or -n for a signal n."""
    if lines := said.strip().splitlines():
        return lines[-1].removeprefix("Error: ")
    return f"killed by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"


# ----------------------------------------------------------------------
# Which files a batch converts: those that are named, and those in folders.


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
    """Return whether a file has the line, maybe behind previews of at most a megabyte."""
    with path.open("rb") as file:
        return (b"\n" + first_line) in b"\n" + file.read(1 << 20)
