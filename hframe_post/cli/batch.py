"""``hframe-post batch``: many files, each converted by a process of its own.

A process for each file, since then nothing that happens to one (not enough memory, a crash) can
happen to another, and the bytes are those of a single conversion.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import click

from hframe_post.cli.options import (
    LazyChoice,
    files_read,
    json_option,
    limits_option,
    on_limit_option,
    open_json,
    printer_option,
    strategies,
)

SUFFIXES = (".gcode", ".gco", ".g")  # of what is converted in a folder
SETTLED = 2.0  # s without change, after which an upload is taken to be complete
State = Literal["waiting", "running", "done", "skipped", "failed"]


@dataclass(frozen=True, slots=True)
class Job:
    """A file to convert, and how far it is. error: a line; summary: that of ``convert``."""

    source: Path
    target: Path
    state: State = "waiting"
    began: float = 0.0
    seconds: float = 0.0
    error: str = ""
    summary: dict[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Without what is empty."""
        told: dict[str, Any] = {"source": str(self.source), "target": str(self.target)}
        told |= {"state": self.state, "seconds": round(self.seconds, 3)}
        told |= {"error": self.error} if self.error else {}
        return told | ({"summary": self.summary} if self.summary else {})

    def as_text(self) -> str:
        """What became of it: a line."""
        told = f"{self.state:8s}{self.source}"
        if self.error:
            return f"{told}: {self.error}"
        return f"{told} → {self.target} ({self.seconds:.1f} s{self.error_predicted()})"

    def error_predicted(self) -> str:
        """Contour error before and after, µm RMS."""
        told = self.summary.get("contour_error_um", {})
        values = [
            told[name]["rms"] for name in ("none", self.summary.get("compensation")) if name in told
        ]
        return f", {values[0]:.0f} → {values[-1]:.1f} µm" if len(values) > 1 else ""


@click.command()
@click.argument("sources", nargs=-1, type=click.Path(path_type=Path, exists=True, dir_okay=False),
                metavar="[FILE]...")  # fmt: skip
@click.option(
    "-d", "--directory", "folder", required=True, type=click.Path(path_type=Path, file_okay=False),
    help="Where the converted files go, under their names.",
)  # fmt: skip
@click.option(
    "-j", "--jobs", type=click.IntRange(1, 256), default=os.cpu_count() or 1,
    show_default="one a processor", help="Files at a time.",
)  # fmt: skip
@printer_option
@click.option("-c", "--compensation", type=LazyChoice(strategies), help="Default: the profile's.")
@limits_option
@on_limit_option
@click.option(
    "--resume", is_flag=True,
    help="Skip what is there already, converted with the same settings from a file not newer.",
)  # fmt: skip
@click.option(
    "--watch", "watched", type=click.Path(path_type=Path, file_okay=False, exists=True),
    metavar="FOLDER", help="Convert what lands in a folder, until stopped with Ctrl-C.",
)  # fmt: skip
@json_option
@click.option("-q", "--quiet", is_flag=True, help="No table, no summary.")
@click.pass_context
def batch(
    context: click.Context, sources: tuple[Path, ...], folder: Path, jobs: int, printer: str,
    compensation: str | None, limits: str, on_limit: str, resume: bool, watched: Path | None,
    json_file: Path | None, quiet: bool,
) -> None:  # fmt: skip
    """Convert many files at a time; one that fails does not stop the others.

    Exit status 0: all are converted; 1: some failed; 2: wrong usage.

    \b
    Examples:
      hframe-post batch jobs/*.gcode -d out/ -p my.toml --resume
      hframe-post batch --watch uploads/ -d printable/
    """
    from hframe_post.printer.profile import load
    from hframe_post.writers.atomic_file import Outputs

    if bool(sources) == (watched is not None):
        raise click.UsageError("give either files or --watch FOLDER")
    if watched is not None and json_file is not None:
        raise click.UsageError("--watch never ends, so there is no summary for --json")
    load(printer)  # whole and sound, before any file is begun
    folder.mkdir(parents=True, exist_ok=True)
    options = ["-p", printer, "--limits", limits, "--on-limit", on_limit]
    options += ["-c", compensation] if compensation else []
    settled = _settings(printer, compensation, limits, on_limit) if resume or watched else b""
    if watched is not None:
        if watched.resolve() == folder.resolve():
            raise click.UsageError("the folder that is watched cannot take the converted files")
        _watch(watched, folder, jobs, options, settled, quiet)
        return
    pending = _jobs(sources, folder, settled)
    with Outputs(files_read(*sources, printer)) as outputs:
        write_json = open_json(outputs, json_file)
        done = _run(pending, jobs, options, quiet)
        failed = sum(job.state == "failed" for job in done)
        write_json({"files": [job.as_json() for job in done], "failed": failed})
    if not quiet:
        skipped = sum(job.state == "skipped" for job in done)
        click.echo(f"{len(done) - failed - skipped} converted, {skipped} skipped, {failed} failed",
                   err=True)  # fmt: skip
    context.exit(1 if failed else 0)


def _jobs(sources: tuple[Path, ...], folder: Path, settled: bytes) -> list[Job]:
    """One a file; those that are done are skipped. Raises UsageError where two would be one."""
    jobs, taken = [], {path.resolve() for path in sources}
    for source in dict.fromkeys(sources):
        target = folder / source.name
        if target.resolve() in taken:
            raise click.UsageError(f"{target} would be written twice, or replace what is read")
        taken.add(target.resolve())
        state: State = "skipped" if settled and _is_done(source, target, settled) else "waiting"
        jobs.append(Job(source, target, state))
    return jobs


def _settings(printer: str, compensation: str | None, limits: Any, on_limit: str) -> bytes:
    """The first line of what these options convert."""
    from hframe_post.conversion.pipeline import Options, stamp
    from hframe_post.gcode.commands import STAMP
    from hframe_post.printer.profile import load

    profile = load(printer)
    strategy = compensation or profile.compensation.strategy
    options = Options(strategy, limits=limits, clamp=on_limit == "clamp")
    return b"%s %s\n" % (STAMP, stamp(profile, options).encode())


def _is_done(source: Path, target: Path, settled: bytes) -> bool:
    if not target.is_file() or target.stat().st_mtime < source.stat().st_mtime:
        return False
    with target.open("rb") as file:
        return file.readline(len(settled) + 1) == settled


# ---------------------------------------------------------------------- processes


@dataclass
class _Processes:
    """Those that run, so that none is left behind."""

    options: list[str]
    running: set[subprocess.Popen[bytes]] = field(default_factory=set)
    stopped: bool = False

    def convert(self, job: Job) -> Job:
        """The job, done or failed."""
        if self.stopped:
            return replace(job, state="failed", error="stopped")
        command = [sys.executable, "-m", "hframe_post", "convert", str(job.source), "-o",
                   str(job.target), "-q", "--json", "-", *self.options]  # fmt: skip
        began = time.monotonic()
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        self.running.add(process)
        told, error = process.communicate()
        self.running.discard(process)
        seconds = time.monotonic() - began
        if process.returncode == 0:
            return replace(job, state="done", seconds=seconds, summary=json.loads(told))
        return replace(
            job, state="failed", seconds=seconds, error=_cause(process.returncode, error)
        )

    def stop(self) -> None:
        """None begins any more, and those that run end."""
        self.stopped = True
        for process in list(self.running):
            process.terminate()


def _cause(status: int, error: bytes) -> str:
    """A line of what a process said, or how it ended without a word."""
    lines = error.decode("utf-8", "replace").strip().splitlines()
    if lines:
        return lines[-1].removeprefix("Error: ")
    return f"killed by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"


def _run(pending: list[Job], jobs: int, options: list[str], quiet: bool) -> list[Job]:
    """All of them, in their order, once they are done."""
    done = list(pending)
    processes = _Processes(options)
    waiting = iter([k for k, job in enumerate(pending) if job.state == "waiting"])
    with _shown(done, quiet) as show, ThreadPoolExecutor(jobs) as pool:
        running: dict[Future[Job], int] = {}

        def begin() -> None:
            for k in waiting:
                done[k] = replace(done[k], state="running", began=time.monotonic())
                running[pool.submit(processes.convert, done[k])] = k
                if len(running) == jobs:
                    return

        try:
            begin()
            while running:
                finished, _ = wait(running, timeout=0.25, return_when=FIRST_COMPLETED)
                for future in finished:
                    k = running.pop(future)
                    done[k] = future.result()
                    show(done[k])
                if finished:
                    begin()
                show(None)
        finally:
            processes.stop()
    return done


# ---------------------------------------------------------------------- watching


def _watch(
    watched: Path, folder: Path, jobs: int, options: list[str], settled: bytes, quiet: bool
) -> None:
    """Converts what is there, what changes and what comes. Ends with Ctrl-C."""
    try:
        from watchfiles import watch
    except ImportError:
        raise click.UsageError(
            "--watch needs the package watchfiles: pip install 'hframe-post[watch]'"
        ) from None

    if not quiet:
        click.echo(f"watching {watched}, Ctrl-C ends", err=True)
    failed: dict[Path, tuple[int, int]] = {}  # not tried again until they change
    for _ in watch(watched, recursive=False, yield_on_timeout=True, rust_timeout=1000,
                   raise_interrupt=False):  # fmt: skip
        found = [path for path in sorted(watched.iterdir()) if failed.get(path) != _version(path)]
        found = [path for path in found if _is_gcode(path) and _is_complete(path)]
        pending = [job for job in _jobs(tuple(found), folder, settled) if job.state == "waiting"]
        for job in _run(pending, jobs, options, quiet) if pending else ():
            if job.state == "failed":
                failed[job.source] = _version(job.source)


def _version(path: Path) -> tuple[int, int]:
    try:
        told = path.stat()
    except OSError:  # taken away in the meantime
        return 0, 0
    return told.st_mtime_ns, told.st_size


def _is_gcode(path: Path) -> bool:
    named = path.suffix.lower() in SUFFIXES and not path.name.startswith(".")
    return named and path.is_file()


def _is_complete(path: Path) -> bool:
    """Whether nobody has written there for a while."""
    return time.time() - _version(path)[0] / 1e9 >= SETTLED


# ---------------------------------------------------------------------- what is shown


@contextmanager
def _shown(jobs: list[Job], quiet: bool) -> Iterator[Callable[[Job | None], None]]:
    """A table that lives on a terminal, lines of what is done elsewhere."""
    if quiet:
        yield lambda finished: None
    elif not sys.stderr.isatty():
        yield lambda finished: click.echo(finished.as_text(), err=True) if finished else None
    else:
        from rich.console import Console
        from rich.live import Live

        console = Console(stderr=True)
        with Live(_table(jobs, console.height), console=console, auto_refresh=False) as live:

            def show(finished: Job | None) -> None:
                live.update(_table(jobs, console.height), refresh=True)

            yield show


def _table(jobs: list[Job], height: int) -> Any:
    """What runs and what failed before all else; as many rows as there is room for."""
    from rich.table import Table
    from rich.text import Text

    styles = {"done": "green", "failed": "bold red", "running": "yellow", "skipped": "dim",
              "waiting": "dim"}  # fmt: skip
    order = ("running", "failed", "done", "waiting", "skipped")
    rows = sorted(jobs, key=lambda job: order.index(job.state))
    room = max(height - 6, 3)
    table = Table("file", "state", "time", "contour error", box=None, padding=(0, 2, 0, 0))
    for job in rows[:room]:
        seconds = time.monotonic() - job.began if job.state == "running" else job.seconds
        told = job.error or job.error_predicted().removeprefix(", ")
        table.add_row(
            Text(job.source.name), Text(job.state, styles[job.state]),
            f"{seconds:.0f} s" if seconds else "", Text(told),
        )  # fmt: skip
    if len(rows) > room:
        table.add_row(Text(f"and {len(rows) - room} more", "dim"))
    finished = sum(job.state not in ("waiting", "running") for job in jobs)
    table.caption = f"{finished} of {len(jobs)}"
    return table
