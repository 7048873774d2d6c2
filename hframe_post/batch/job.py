"""One file of a batch and its state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from hframe_post.errors import HframeError

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
        """Return the job without empty entries."""
        entries = {
            "source": str(self.source), "target": str(self.target), "state": self.state,
            "seconds": round(self.seconds, 3), "worker": self.worker, "error": self.error,
            "summary": self.summary,
        }  # fmt: skip
        return {name: value for name, value in entries.items() if value not in ("", {})}

    def as_text(self) -> str:
        """Return the result in one line."""
        line = f"{self.state:8s}{self.source}"
        if self.error:
            return f"{line}: {self.error}"
        return f"{line} → {self.target} ({self.seconds:.1f} s{self._contour_error()})"

    def _contour_error(self) -> str:
        """The predicted error without and with compensation, µm RMS."""
        errors = self.summary.get("contour_error_um", {})
        names = ("none", self.summary.get("compensation"))
        values = [errors[name]["rms"] for name in names if name in errors]
        return f", {values[0]:.0f} → {values[-1]:.1f} µm" if len(values) > 1 else ""


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
