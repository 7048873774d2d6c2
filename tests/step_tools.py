"""Samples to step, and step files, made and read in the plainest way."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.conversion.options import Options
from hframe_post.conversion.print_report import Report
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.settings import Printer, Steps
from hframe_post.stream.types import Dwell, Event, Handling, ModalState, Passthrough, Samples
from hframe_post.writers.steps import StepCounts, StepGenerator
from hframe_post.writers.tables import MOTORS, Note, Start, Stepped

STATE = ModalState(True, True, 0.0, 25.0, (0.0, 0.0, 0.0))


def block(xyze: Array, first: int = 0, events: tuple[Event, ...] = ()) -> Samples:
    """Return samples (n, 4) whose command is the path; the line of sample i is i + 1."""
    line = np.arange(first, first + len(xyze)) + 1
    last = events[-1] if events else None
    ends = isinstance(last, Dwell) and released(last)
    return Samples(first, xyze, line, events, {"none": xyze[:, :2]}, ends)


def released(pause: Dwell) -> bool:
    """Return whether the machine is released in it."""
    action = pause.action
    return isinstance(action, Passthrough) and action.handling is Handling.RELEASE


def line(text: bytes, handling: Handling, seconds: float = 0.0) -> Passthrough:
    return Passthrough(1, text, handling, STATE, seconds)


@dataclass
class Stepping:
    """Steps of a stream of samples: tick, motor, direction of each."""

    rows: Integers
    starts: list[Start]
    notes: list[Note]
    counts: StepCounts

    def of(self, motor: int) -> tuple[Integers, Integers]:
        """Return ticks and directions of one motor."""
        mine = self.rows[self.rows[:, 1] == motor]
        return mine[:, 0], mine[:, 2]


def stepped(blocks: list[Samples], table: Steps, kinematics: Kinematics | None = None) -> Stepping:
    stepper = StepGenerator("none", kinematics or Kinematics("cartesian"), table)
    keys = []
    starts: list[Start] = []
    notes: list[Note] = []
    for item in stepper.step(blocks):
        if isinstance(item, Start):
            starts.append(item)
        elif isinstance(item, Stepped):
            keys.append(item.keys)
            notes += item.notes
    whole = np.concatenate(keys) if keys else np.zeros(0, dtype=np.int64)
    rows = np.column_stack([whole // 8, whole // 2 % 4, whole % 2 * 2 - 1])
    return Stepping(rows, starts, notes, stepper.counts)


def write_steps(
    path: Path, lines: list[bytes], printer: Printer, strategy: str = "racking"
) -> Report:
    """Write a whole conversion to an uncompressed step file, without its events."""
    whole = WholeFile(iter(lines), printer, Options(strategy, format="steps"))
    path.write_bytes(b"".join(piece for piece in whole.steps() if isinstance(piece, bytes)))
    return whole.report


def read_steps(text: bytes, printer: Printer) -> tuple[Integers, Array]:
    """Return the tick (n,) of each step and start of a step file, and x, y, z, e (n, 4) then."""
    table = printer.steps
    assert table is not None
    at, ticks, positions = [0] * 4, list[int](), list[list[int]]()
    for row in text.decode().splitlines():
        kind, *words = row.split(",")
        if kind == "#start":
            at = [int(word) for word in words[1:]]
        elif kind.isdigit():
            at[MOTORS.index(words[0])] += 1 if words[1] == "1" else -1
        else:
            continue
        ticks.append(int(words[0] if kind == "#start" else kind))
        positions.append(at.copy())
    xyze = np.array(positions) * [table.belt, table.belt, table.z, table.e]
    xyze[:, :2] = xyze[:, :2] @ np.linalg.inv(printer.kinematics.matrix).T
    return np.array(ticks), xyze
