"""Running figures of a conversion, and what is told of them: text and JSON."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

from hframe_post.arrays import Array
from hframe_post.compensation.guard import Peaks
from hframe_post.prediction.statistics import ErrorStatistics
from hframe_post.writers.print_time import duration

STRATEGY_NAMES = {
    "none": "no compensation",
    "fbs": "ringing only (fbs)",
    "racking": "ringing and racking",
}


@dataclass(frozen=True, slots=True)
class StepReport:
    """What a step file holds: rows, ticks of its clock, steps by motor."""

    rows: int
    ticks: int
    clock_hz: float
    motors: dict[str, int]


@dataclass
class Report:
    """What one conversion did. Times in s, lengths in mm."""

    strategy: str
    moves: int = 0
    lines_read: int = 0
    lines_written: int = 0
    time_before: float = 0.0
    time_after: float = 0.0
    filament_before: float = 0.0
    filament_after: float = 0.0
    peaks: Peaks = field(default_factory=Peaks)
    contour: dict[str, ErrorStatistics] = field(default_factory=dict)
    steps: StepReport | None = None
    busiest_second: int = 0  # most lines of motion in a second
    lines_per_second: float = math.inf  # that the firmware can take

    def add_errors(self, errors: dict[str, Array]) -> None:
        """Takes contour errors by strategy."""
        for name, values in errors.items():
            self.contour.setdefault(name, ErrorStatistics()).add(values)

    def as_json(self) -> dict[str, Any]:
        """Everything, ready for ``json.dumps``."""
        x, y = self.peaks.axis_acceleration.tolist()
        return {
            "compensation": self.strategy,
            "moves": self.moves,
            "lines_read": self.lines_read,
            "lines_written": self.lines_written,
            "print_time_s": {
                "before": round(self.time_before, 3),
                "after": round(self.time_after, 3),
            },
            "filament_mm": {
                "before": round(self.filament_before, 5),
                "after": round(self.filament_after, 5),
            },
            "contour_error_um": {n: s.micrometres() for n, s in sorted(self.contour.items())},
            "peak_belt_speed": round(self.peaks.belt_velocity, 3),
            "peak_belt_acceleration": round(self.peaks.belt_acceleration, 1),
            "peak_axis_acceleration": {"x": round(x, 1), "y": round(y, 1)},
            "busiest_second_lines": self.busiest_second,
            "clamped_samples": self.peaks.clamped,
            **({"steps": asdict(self.steps)} if self.steps else {}),
        }

    def as_text(self) -> str:
        """A few lines for a person."""
        change = 100.0 * (self.time_after / self.time_before - 1.0) if self.time_before else 0.0
        lines = [
            f"{self.moves} moves, {self.lines_read} lines read, {self.lines_written} written",
            f"print time  {duration(self.time_before)} → {duration(self.time_after)} "
            f"({change:+.1f} %)",
            f"filament    {self.filament_after:.2f} mm, unchanged",
        ]
        for name in sorted(self.contour, key=list(STRATEGY_NAMES).index):
            um = self.contour[name].micrometres()
            lines.append(
                f"predicted   {STRATEGY_NAMES[name]}: contour error {um['rms']:.1f} µm RMS, "
                f"{um['p95']:.1f} µm at 95 %, {um['peak']:.0f} µm peak"
            )
        lines.append(
            f"belts       at most {self.peaks.belt_velocity:.0f} mm/s, "
            f"{self.peaks.belt_acceleration:.0f} mm/s²"
        )
        if self.steps:
            motors = ", ".join(f"{motor} {n}" for motor, n in self.steps.motors.items())
            lines.append(
                f"steps       {self.steps.rows} rows, {self.steps.ticks} ticks of "
                f"{self.steps.clock_hz:g} Hz; {motors}"
            )
        return "\n".join(lines + self.warnings())

    def warnings(self) -> list[str]:
        """What a person must not overlook."""
        lines = []
        if not self.moves:
            lines.append("NOTHING     was compensated: no move starts at a known position")
        if self.busiest_second > self.lines_per_second:
            lines.append(
                f"TOO DENSE   up to {self.busiest_second} lines in a second, and the profile's "
                f"lines_per_second is {self.lines_per_second:g}: the printer may stutter there"
            )
        if self.peaks.clamped:
            lines.append(
                f"CLAMPED     {self.peaks.clamped} ms of motion at the printer's limits, first at "
                f"line {self.peaks.clamped_line}; less is compensated there"
            )
        return lines
