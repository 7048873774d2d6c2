"""The extras module ``[hframe_live]``: while it is on, a kernel takes the input shaper's place.

It is linked as ``hframe_live`` into klippy/extras, or Kalico's plugins, and needs neither
hframe-post nor numpy there: ``kernel_file`` reads what ``model/kernel.py`` computed, and compiles
``hframe_live.c``.

It is on if the owner has it on and nothing that needs the bare motion is running: homing, probing,
tests of resonances, and files that turn the input shaper off, as converted files and measurements
of hframe-post do. It changes at rest only, with all steps made: then both kinematics have every
motor at the same place. Moves that ask for more than the motors can follow are slowed down.
"""

from __future__ import annotations

import importlib
import logging
import math
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from .kernel_file import FIGURES, LIMITS, library, read, taps

NAME = "hframe_live"
KINEMATICS = ("cartesian", "corexy", "hybrid_corexy", "corexz")
SET_SHAPER = "SET_INPUT_SHAPER"
BARE = (  # commands that measure the printer, Klipper's and Shake&Tune's, or set the input shaper
    "TEST_RESONANCES", "SHAPER_CALIBRATE", SET_SHAPER, "AXES_MAP_CALIBRATION",
    "AXES_SHAPER_CALIBRATION", "COMPARE_BELTS_RESPONSES", "CREATE_VIBRATIONS_PROFILE",
    "EXCITATE_AXIS_AT_FREQ",
)  # fmt: skip
TOWER = ("on", "bare", "shaper")  # SET_HFRAME_LIVE TOWER=0, 1, 2 and again


class HframeLive:
    """Kernel and state of ``[hframe_live]``. Raises config.error, with the next step."""

    def __init__(self, config: Any) -> None:
        self.printer = config.get_printer()
        folder = Path(self.printer.get_start_args().get("config_file", "")).parent
        self.path = folder / os.path.expanduser(config.get("kernel", "printer.kernel"))
        self.enabled = config.getboolean("enabled", True)
        self.reasons, self.tower = set[str](), ""
        self.active = self.unshaped = self.limited = False
        self.motors: list[tuple[Any, Any, Any]] = []  # stepper, Klipper's kinematics, ours
        self.behind: dict[Any, Any] = {}  # ours by Klipper's
        self.kernel: dict[str, Any] | None = None
        if self.path.is_file():
            try:
                self._load(config)
            except (ValueError, OSError) as error:
                raise config.error(
                    f"[{NAME}] {self.path}: {error}. To print without it, put a # before each line "
                    f"of [{NAME}]"
                ) from None
        self.shaper = None
        if config.has_section("input_shaper"):
            self.shaper = self.printer.load_object(config, "input_shaper")
        self.gcode = self.printer.lookup_object("gcode")
        if self.shaper is None:
            self.gcode.register_command(SET_SHAPER, lambda gcmd: None)
        desc = "Compensate in Klipper: ENABLE=1 or 0; without it, show whether it does"
        self.gcode.register_command("SET_HFRAME_LIVE", self._command, desc=desc)
        for event, handler in (
            ("klippy:connect", self._connect),
            ("klippy:ready", self._ready),
            ("toolhead:set_position", self._forget),
            ("homing:homing_move_begin", lambda move: self._set("homing", True)),
            ("homing:homing_move_end", lambda move: self._set("homing", False)),
            ("virtual_sdcard:reset_file", self._next_file),
        ):
            self.printer.register_event_handler(event, handler)

    def _load(self, config: Any) -> None:
        kernel, printer = read(self.path.read_bytes()), config.getsection("printer")
        kinematics = printer.get("kinematics")
        if kinematics not in KINEMATICS or config.has_section("dual_carriage"):
            what = "a second carriage" if kinematics in KINEMATICS else f"kinematics {kinematics}"
            raise ValueError(f"{what} is not supported: convert files instead")
        if kinematics != kernel["kinematics"]:
            raise ValueError(
                f"it is for kinematics {kernel['kinematics']}, and this printer has {kinematics}: "
                "write it with this printer's profile"
            )
        factors = (1.0, kernel["reserve"], kernel["reserve"])
        self.most = [kernel["limits"][name] * k for name, k in zip(LIMITS, factors, strict=True)]
        for name, most in zip(LIMITS, self.most, strict=True):
            if (now := printer.getfloat(name, 5.0)) > 1.001 * most:
                raise ValueError(
                    f"it is for {name} up to {most:g}, which is now {now:g}: run 'hframe-post "
                    "setup', then 'hframe-post identify'"
                )
        package = __name__.split(".", maxsplit=1)[0]
        parent = "klippy." if package == "klippy" else ""  # Kalico's is a package
        self.ffi, self.lib = library(importlib.import_module(f"{parent}chelper"))
        x, y = (config.getsection(f"stepper_{axis}") for axis in "xy")
        travel = [(k.getfloat("position_min", 0.0), k.getfloat("position_max")) for k in (x, y)]
        self.taps, self.kernel = taps(self.ffi, kernel, travel), kernel

    def _connect(self) -> None:
        self.toolhead = self.printer.lookup_object("toolhead")
        self.queuing = self.printer.lookup_object("motion_queuing", None)
        self.kinematics = self.toolhead.get_kinematics()
        self.kinematics.check_move = partial(self._check_move, self.kinematics.check_move)
        self._update()

    def _check_move(self, former: Callable[[Any], Any], move: Any) -> None:
        """Keep a move, as Klipper does those of z, within what the motors can follow."""
        former(move)
        if not self.active:
            return
        velocity, acceleration, corner = self.most
        beyond = move.accel > 1.001 * acceleration and any(move.axes_d[:2])
        move.limit_speed(velocity, acceleration)
        deviation = corner**2 * (math.sqrt(2.0) - 1.0) / move.accel
        move.junction_deviation = min(move.junction_deviation, deviation)
        if beyond and not self.limited:
            self.limited = True
            self.gcode.respond_info(f"{NAME}: acceleration limited to {acceleration:g} mm/s^2")

    def _ready(self) -> None:
        for name in BARE:
            former = self.gcode.register_command(name, None)
            if former is not None:
                desc = self.gcode.gcode_help.get(name)
                self.gcode.register_command(name, partial(self._bare, name, former), desc=desc)
        logging.info("%s: %s", NAME, self._said())
        if self.kernel is None:
            self.gcode.respond_info(f"{NAME}: {self._said()}")

    def _bare(self, name: str, former: Callable[[Any], Any], gcmd: Any) -> None:
        """Run a command with the kernel off and the input shaper as it is without it."""
        self._set("command", True)
        try:
            former(gcmd)
            if name == SET_SHAPER:  # a file that turns the shaper off is to move as it is
                hz = [gcmd.get_float(f"SHAPER_FREQ_{axis}", None) for axis in "XY"]
                if any(each is not None for each in hz):
                    (self.reasons.discard if any(hz) else self.reasons.add)("unshaped file")
        finally:
            self._set("command", False)

    def _next_file(self) -> None:
        self.tower, self.limited = "", False
        self._set("unshaped file", False)

    def _set(self, reason: str, off: bool) -> None:
        (self.reasons.add if off else self.reasons.discard)(reason)
        self._update()

    def _update(self) -> None:
        """Turn on or off what the state asks for, at rest."""
        wanted = self.kernel is not None and self.enabled and not self.reasons
        active = wanted and self.tower in ("", "on")
        unshaped = active or (wanted and self.tower == "bare")
        if (active, unshaped) == (self.active, self.unshaped):
            return
        self.toolhead.flush_step_generation()
        if self.active and not active:
            self._give_back()
        if self.shaper is not None and unshaped != self.unshaped:
            (self.shaper.disable_shaping if unshaped else self.shaper.enable_shaping)()
        if active and not self.active:
            self._take()
        self.active, self.unshaped = active, unshaped

    def _take(self) -> None:
        self.motors.clear()
        for stepper in self.kinematics.get_steppers():
            if not any(map(stepper.is_active_axis, "xy")):
                continue
            theirs = stepper.get_stepper_kinematics()
            if theirs not in self.behind:
                ours = self.lib.hframe_live_alloc(theirs, self.taps)
                if ours == self.ffi.NULL:
                    raise self.printer.config_error(
                        f"[{NAME}] cannot move {stepper.get_name()}: convert files instead"
                    )
                self.behind[theirs] = self.ffi.gc(ours, self.lib.free)
            self.motors.append((stepper, theirs, self.behind[theirs]))
        for stepper, theirs, ours in self.motors:
            self.lib.hframe_live_hand_over(theirs, ours)
            self.lib.hframe_live_reset(ours)
            stepper.set_stepper_kinematics(ours)
        self._note_window(on=True)

    def _give_back(self) -> None:
        for stepper, theirs, ours in self.motors:
            self.lib.hframe_live_hand_over(ours, theirs)
            stepper.set_stepper_kinematics(theirs)
        self._note_window(on=False)

    def _note_window(self, on: bool) -> None:
        """Tell Klipper how far steps depend on the path around them."""
        if hasattr(self.queuing, "check_step_generation_scan_windows"):
            self.queuing.check_step_generation_scan_windows()
        elif self.motors:
            window = self.lib.hframe_live_window(self.motors[0][2])
            self.toolhead.note_step_generation_scan_time(*(window, 0.0)[:: 1 if on else -1])

    def _forget(self) -> None:
        for _, _, ours in self.motors if self.active else ():
            self.lib.hframe_live_reset(ours)

    def _command(self, gcmd: Any) -> None:
        enable = gcmd.get_int("ENABLE", None, minval=0, maxval=1)
        tower = gcmd.get_float("TOWER", None, minval=0.0)
        if tower is not None:
            self.tower = TOWER[int(tower) % len(TOWER)]
        if enable is not None:
            self.enabled = bool(enable)
            self.reasons.discard("unshaped file")
        self._update()
        gcmd.respond_info(f"{NAME}: {self._said()}")

    def _said(self) -> str:
        if self.kernel is None:
            return f"off: no kernel {self.path} yet. Measure the printer: HFRAME_CALIBRATE"
        if self.active:
            leaves, without, deviation = (self.kernel[key] for key in FIGURES[:3])
            shown = f"on: {1e3 * leaves:.1f} um where {1e3 * without:.0f} would be"
            return f"{shown}, at most {deviation:.2f} mm off the path"
        return f"off: {', '.join(sorted(self.reasons)) or self.tower or 'ENABLE=0'}"

    def get_status(self, eventtime: float) -> dict[str, Any]:
        status: dict[str, Any] = {"enabled": self.enabled, "active": self.active}
        status |= {"off": sorted(self.reasons), "limited": self.limited}
        if self.kernel is not None:
            shown = ("profile", "made_by", "measured", *FIGURES)
            status |= {key: self.kernel[key] for key in shown}
        return status


def load_config(config: Any) -> HframeLive:
    return HframeLive(config)
