"""Samples to step, and step files, made and read in the plainest way."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.conversion.pipeline import Options, convert_to_steps
from hframe_post.conversion.report import Report
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.settings import Printer, Steps
from hframe_post.stream.types import Event, Handling, ModalState, Passthrough, Samples
from hframe_post.writers.step_file import Note, Start, Stepped
from hframe_post.writers.steps import Counts, step

STATE = ModalState(True, True, 0.0, 25.0, (0.0, 0.0, 0.0))


def block(xyze: Array, first: int = 0, events: tuple[Event, ...] = ()) -> Samples:
    """Samples (n, 4) whose command is the path; the line of sample i is i + 1."""
    line = np.arange(first, first + len(xyze)) + 1
    return Samples(first, xyze, line, events, {"none": xyze[:, :2]})


def line(text: bytes, handling: Handling, seconds: float = 0.0) -> Passthrough:
    return Passthrough(1, text, handling, STATE, seconds)


@dataclass
class Stepping:
    """What a stream of samples was stepped into: tick, motor, direction of each step."""

    rows: Integers
    starts: list[Start] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)

    def of(self, motor: int) -> tuple[Integers, Integers]:
        """Ticks and directions of one motor."""
        mine = self.rows[self.rows[:, 1] == motor]
        return mine[:, 0], mine[:, 2]


def stepped(blocks: list[Samples], table: Steps, kinematics: Kinematics | None = None) -> Stepping:
    counts, keys = Counts(), []
    starts: list[Start] = []
    notes: list[Note] = []
    for item in step(blocks, "none", kinematics or Kinematics("cartesian"), table, counts):
        if isinstance(item, Start):
            starts.append(item)
        elif isinstance(item, Stepped):
            keys.append(item.keys)
            notes += item.notes
    whole = np.concatenate(keys) if keys else np.zeros(0, dtype=np.int64)
    rows = np.column_stack([whole // 8, whole // 2 % 4, whole % 2 * 2 - 1])
    return Stepping(rows, starts, notes, counts)


def write_steps(
    path: Path, lines: list[bytes], printer: Printer, kind: str = "steps", strategy: str = "racking"
) -> Report:
    """A whole conversion to an uncompressed step file, without its events."""
    report = Report(strategy)
    pieces = convert_to_steps(iter(lines), printer, Options(strategy), report, kind)
    path.write_bytes(b"".join(piece for piece in pieces if isinstance(piece, bytes)))
    return report
