"""printer.cfg, as `setup` reads it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hframe_post.firmware.configuration import Source
from hframe_post.firmware.klipper.check import warnings
from hframe_post.firmware.klipper.macros import FILE, macros
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.firmware.klipper.settings import from_klipper, kinematics_in
from hframe_post.printer.new_profile import Tables
from hframe_post.printer.settings import Printer


class KlipperSource(Source):
    """A printer.cfg. Raises HframeError if it is none, or if its printer cannot be compensated."""

    alone = "for Klipper give printer.cfg alone: it names all that it needs"

    def __init__(self, path: Path) -> None:
        self.path, self._config = path, KlipperConfig(path)
        self.possible, self.decided = kinematics_in(self._config), "kinematics of [printer]"
        self.warnings = [self._config.unsaved] if self._config.unsaved else []
        self.warnings += warnings(self._config)
        names = ", ".join(self._config.accelerometers())
        self.sensors = names or "none in printer.cfg; you need one to measure"

    def tables(self, kinematics: str, bed: tuple[float, float] | None) -> Tables:
        return from_klipper(self._config, kinematics)

    def companions(self, profile: Printer) -> dict[str, str]:
        return {FILE: macros(profile, self._config)}

    def next_steps(self, profile: Printer, target: Path, quoted: Callable[[Path], str]) -> str:
        sections = target.with_name(FILE)
        include = f"[include {sections.name}]"
        if self._config.has(include[1:-1]):
            first = f"Copy {sections} next to your printer.cfg, which includes it already."
        else:
            first = (
                f"Copy {sections} next to your printer.cfg, and add this line to printer.cfg, at "
                f"its end but above the SAVE_CONFIG block:\n     {include}"
            )
        if not profile.invented:
            return f"\nNext:\n  1. {first}\n  2. Restart Klipper."
        return f"""
Next:
  1. {first}
  2. Restart Klipper, and run hframe-post measure -o recordings/measure.gcode, which says how to go
     on. Or, with recordings of TEST_RESONANCES (OUTPUT=raw_data) in the folder recordings:
     hframe-post identify recordings --printer-cfg {quoted(self.path)} -o {quoted(target)}"""
