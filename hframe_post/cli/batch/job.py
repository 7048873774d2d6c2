"""A file to convert, how far it is, and whether it is done already."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import click

State = Literal["waiting", "running", "done", "skipped", "failed"]


@dataclass(frozen=True, slots=True)
class Job:
    """A file to convert, and how far it is.

    error: a line; summary: that of ``convert``; worker: of a cluster, that converted it.
    """

    source: Path
    target: Path
    state: State = "waiting"
    began: float = 0.0
    seconds: float = 0.0
    error: str = ""
    summary: dict[str, Any] = field(default_factory=dict)
    worker: str = ""

    @property
    def finished(self) -> bool:
        """Whether nothing more is done about it."""
        return self.state not in ("waiting", "running")

    def as_json(self) -> dict[str, Any]:
        """Without what is empty."""
        told: dict[str, Any] = {"source": str(self.source), "target": str(self.target)}
        told |= {"state": self.state, "seconds": round(self.seconds, 3)}
        more = {"worker": self.worker, "error": self.error, "summary": self.summary}
        return told | {name: value for name, value in more.items() if value}

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


def jobs_of(sources: Sequence[Path], folder: Path, first_line: bytes) -> list[Job]:
    """One a file; those that are done are skipped. Raises UsageError where two would be one.

    first_line: of a file that is converted with the same settings; empty: none is skipped.
    """
    jobs, taken = [], {path.resolve() for path in sources}
    for source in dict.fromkeys(sources):
        target = folder / source.name
        if target.resolve() in taken:
            raise click.UsageError(f"{target} would be written twice, or replace what is read")
        taken.add(target.resolve())
        done = first_line and target.is_file() and _newer(target, source)
        skipped = done and begins_with(target, first_line)
        jobs.append(Job(source, target, "skipped" if skipped else "waiting"))
    return jobs


def _newer(target: Path, source: Path) -> bool:
    return target.stat().st_mtime >= source.stat().st_mtime


def begins_with(path: Path, first_line: bytes) -> bool:
    """Whether that is the first line of a file."""
    with path.open("rb") as file:
        return file.readline(len(first_line) + 1) == first_line


def first_line(printer: str, compensation: str | None, limits: Any, on_limit: str) -> bytes:
    """The first line of what these options convert."""
    from hframe_post.conversion.pipeline import Options, stamp
    from hframe_post.gcode.commands import STAMP
    from hframe_post.printer.profile import load

    profile = load(printer)
    strategy = compensation or profile.compensation.strategy
    options = Options(strategy, limits=limits, clamp=on_limit == "clamp", speed=profile.asked_speed)
    return b"%s %s\n" % (STAMP, stamp(profile, options).encode())
