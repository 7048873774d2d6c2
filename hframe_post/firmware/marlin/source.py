"""Answers to M503 and headers of a build, as `setup` reads them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from hframe_post.firmware.configuration import Source
from hframe_post.firmware.marlin.m503 import MarlinSettings, from_marlin
from hframe_post.printer.new_profile import Known, Tables
from hframe_post.printer.settings import Printer


class MarlinSource(Source):
    """What a printer with Marlin answered. Raises HframeError."""

    def __init__(self, files: Sequence[Path]) -> None:
        self.path = files[0]
        self._settings = MarlinSettings(files)
        self.possible, self.decided = self._settings.kinematics()
        self.warnings = self._settings.warnings()
        self.sensors = "one that a computer or a telephone records: Marlin reads none"
        self._travel = self._settings.travel()
        if not self._travel:
            self.no_travel = (
                f"{self.path} does not say how large the bed is: add --bed 220,220 with its width "
                "and depth in mm, or Configuration.h behind the file"
            )

    def tables(self, kinematics: str, bed: tuple[float, float] | None) -> Tables:
        travel = self._travel
        if bed is not None:
            x, y = bed
            travel = {"x": Known((0.0, x), "as you said"), "y": Known((0.0, y), "as you said")}
        return from_marlin(self._settings, kinematics, travel)

    def next_steps(self, profile: Printer, target: Path, quoted: Callable[[Path], str]) -> str:
        if not profile.invented:
            return ""
        return f"""
Next, with an accelerometer: hframe-post measure -o sweep.gcode, which says how to go on, and
hframe-post identify recordings -o {quoted(target)}
With a ruler only: hframe-post calibrate-print --heat 210,60 -o tower.gcode
A compensated print that you stop midway leaves its limits in the board: send M501 and M82 then. Let
OctoPrint do that: put both into GCODE Scripts, After print job is cancelled."""
