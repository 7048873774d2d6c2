"""What is told of a conversion, as text and JSON: the summaries of its stages."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

from hframe_post.compensation.guard import Clamped, Peaks
from hframe_post.conversion.meters import InputSummary, PrintTime
from hframe_post.conversion.path_meter import PathSummary
from hframe_post.model.strategies import STRATEGIES
from hframe_post.prediction.statistics import ContourErrors
from hframe_post.writers.stream.print_time import duration

GUESSED = 9  # G10 and G11 that may pass: one pair or a few, beside macros


@dataclass(frozen=True, slots=True)
class StepReport:
    """What a step file holds: rows, ticks of its clock, steps by motor."""

    rows: int
    ticks: int
    clock_hz: float
    motors: dict[str, int]


@dataclass(frozen=True, slots=True)
class Report:
    """What one conversion did: the summaries of its stages. Lengths in mm.

    lines_written, filament_after: None where nothing is written; busiest_second: most lines of
    motion in a second, of the lines_per_second that the firmware can take. seconds: of the
    processor, by stage; no two conversions agree in them.
    """

    strategy: str
    read: InputSummary
    path: PathSummary
    time: PrintTime
    peaks: Peaks
    clamped: Clamped
    contour: dict[str, ContourErrors]
    lines_written: int | None = None
    filament_after: float | None = None
    busiest_second: int = 0
    lines_per_second: float = math.inf
    steps: StepReport | None = None
    seconds: dict[str, float] = field(default_factory=dict, compare=False)
    speed: dict[str, Any] | None = None
    speed_text: str = ""

    def as_json(self) -> dict[str, Any]:
        """Everything, ready for ``json.dumps``."""
        x, y = self.peaks.axis_acceleration
        filament = {"before": self.read.filament, "after": self.filament_after}
        written: dict[str, Any] = {
            "lines_written": self.lines_written,
            "busiest_second_lines": self.busiest_second or None,
            "steps": asdict(self.steps) if self.steps else None,
            "speed": self.speed,
        }
        return {
            "compensation": self.strategy,
            "moves": self.read.moves,
            "lines_read": self.read.lines,
            "print_time_s": {
                "before": round(self.time.before, 3),
                "after": round(self.time.after, 3),
            },
            "filament_mm": {k: round(mm, 5) for k, mm in filament.items() if mm is not None},
            "contour_error_um": {n: s.micrometres() for n, s in sorted(self.contour.items())},
            "peak_belt_speed": round(self.peaks.belt_velocity, 3),
            "peak_belt_acceleration": round(self.peaks.belt_acceleration, 1),
            "peak_axis_acceleration": {"x": round(x, 1), "y": round(y, 1)},
            "firmware_retractions": self.read.firmware_retractions,
            **self.path.as_json(),
            "clamped_samples": self.clamped.samples,
            "clamped_mm": round(self.clamped.most, 6),
            **{name: value for name, value in written.items() if value is not None},
        }

    def as_text(self) -> str:
        """A few lines for a person."""
        before, after = self.time.before, self.time.after
        change = 100.0 * (after / before - 1.0) if before else 0.0
        lines = [
            f"{self.read.moves} moves, {self.read.lines} lines read, {self.lines_written} written",
            f"print time  {duration(before)} → {duration(after)} ({change:+.1f} %)",
            f"filament    {self.filament_after:.2f} mm, unchanged",
        ]
        for name in [name for name in STRATEGIES if name in self.contour]:
            um = self.contour[name].micrometres()
            lines.append(
                f"predicted   {STRATEGIES[name].label}: contour error {um['rms']:.1f} µm RMS, "
                f"{um['p95']:.1f} µm at 95 %, {um['peak']:.0f} µm peak "
                f"(with travel {um['all']['rms']:.1f} µm RMS)"
            )
        lines.append(
            f"belts       at most {self.peaks.belt_velocity:.0f} mm/s, "
            f"{self.peaks.belt_acceleration:.0f} mm/s²"
        )
        lines += self.path.as_text()
        if self.steps:
            motors = ", ".join(f"{motor} {n}" for motor, n in self.steps.motors.items())
            lines.append(
                f"steps       {self.steps.rows} rows, {self.steps.ticks} ticks of "
                f"{self.steps.clock_hz:g} Hz; {motors}"
            )
        lines += self.speed_text.splitlines()
        return "\n".join(lines + self.warnings())

    def warnings(self) -> list[str]:
        """What a person must not overlook."""
        lines = []
        if not self.read.moves:
            lines.append("NOTHING     was compensated: no move starts at a known position")
        lines += self.path.warnings()
        if self.busiest_second > self.lines_per_second:
            lines.append(
                f"TOO DENSE   up to {self.busiest_second} lines in a second, and the profile's "
                f"lines_per_second is {self.lines_per_second:g}: the printer may stutter there"
            )
        if (count := self.read.firmware_retractions) > GUESSED:
            lines.append(
                f"GUESSED     how long {count} G10 and G11 take: less is compensated beside them, "
                "unless [retraction] of the profile tells what they do"
            )
        if self.clamped.samples:
            lines.append(
                f"CLAMPED     {self.clamped.samples} ms of motion at the printer's limits, first "
                f"at line {self.clamped.line}, by up to {self.clamped.most:.3f} mm; less is "
                "compensated there"
            )
        return lines
