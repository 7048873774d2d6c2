"""The extras module ``[hframe_live]``: while it is on, a kernel takes the input shaper's place.

It is on if the owner has it on and nothing that needs the bare motion is running: homing, probing,
tests of resonances, and files that turn the input shaper off, as converted files and measurements
of hframe-post do. It changes at rest only, with all steps made: then both kinematics have every
motor at the same place.
"""

from __future__ import annotations

import importlib
import logging
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from .kernel_file import KernelFile, Taps, read
from .native import Native

NAME = "hframe_live"
KINEMATICS = ("cartesian", "corexy", "hybrid_corexy", "corexz")
SET_SHAPER = "SET_INPUT_SHAPER"
BARE = (  # commands that measure the printer, Klipper's and Shake&Tune's, or set the input shaper
    "TEST_RESONANCES", "SHAPER_CALIBRATE", SET_SHAPER, "AXES_MAP_CALIBRATION",
    "AXES_SHAPER_CALIBRATION", "COMPARE_BELTS_RESPONSES", "CREATE_VIBRATIONS_PROFILE",
    "EXCITATE_AXIS_AT_FREQ",
)  # fmt: skip
TOWER = ("on", "off", "shaper")  # SET_HFRAME_LIVE TOWER=0, 1, 2 and again


class HframeLive:
    """Kernel and state of ``[hframe_live]``. Raises config.error, with the next step."""

    def __init__(self, config: Any) -> None:
        self.printer, self.name = config.get_printer(), config.get_name()
        folder = Path(self.printer.get_start_args().get("config_file", "")).parent
        self.path = folder / os.path.expanduser(config.get("kernel", "printer.kernel"))
        self.enabled = config.getboolean("enabled", True)
        self.reasons, self.tower = set[str](), ""
        self.active = self.unshaped = False
        self.motors: list[tuple[Any, Any, Any]] = []  # stepper, Klipper's kinematics, ours
        self.kernel: KernelFile | None = None
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
        self.gcode.register_command(
            "SET_HFRAME_LIVE",
            self._command,
            desc="Compensate in Klipper: ENABLE=1 or 0; without it, show whether it does",
        )
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
        kernel = read(self.path.read_bytes())
        printer = config.getsection("printer")
        kinematics, most = printer.get("kinematics"), kernel.numbers["acceleration"]
        if kinematics not in KINEMATICS or config.has_section("dual_carriage"):
            what = "a second carriage" if kinematics in KINEMATICS else f"kinematics {kinematics}"
            raise ValueError(f"{what} is not supported: convert files instead")
        if kinematics != kernel.names["kinematics"]:
            raise ValueError(
                f"it is for kinematics {kernel.names['kinematics']}, and this printer has "
                f"{kinematics}: write it with this printer's profile"
            )
        if printer.getfloat("max_accel") > 1.001 * most:
            raise ValueError(
                f"it is for max_accel up to {most:g}, which is now "
                f"{printer.getfloat('max_accel'):g}: run 'hframe-post setup', then 'hframe-post "
                "identify'"
            )
        package = __name__.split(".", maxsplit=1)[0]
        parent = "klippy." if package == "klippy" else ""  # Kalico's is a package
        self.native = Native(importlib.import_module(f"{parent}chelper"))
        lib, ffi = self.native.lib, self.native.ffi
        self.taps = self.native.freed(lib.hframe_kernel_alloc())
        refused = 0

        def given(taps: Taps) -> tuple[int, int, Any]:
            return taps.ahead, len(taps.weights), ffi.new("double[]", taps.weights)

        for axis, taps in enumerate((kernel.x, kernel.y)):
            stepper = config.getsection(f"stepper_{'xy'[axis]}")
            travel = stepper.getfloat("position_min", 0.0), stepper.getfloat("position_max")
            refused |= lib.hframe_kernel_axis(self.taps, axis, *travel, *given(taps))
        for each in kernel.couplings:
            where = each.answer, each.command, each.along, each.centre
            refused |= lib.hframe_kernel_coupling(self.taps, *where, *given(each.taps))
        if refused:
            raise ValueError("it has too many taps: write it again with 'hframe-post identify'")
        self.kernel = kernel

    def _connect(self) -> None:
        self.toolhead = self.printer.lookup_object("toolhead")
        self.queuing = self.printer.lookup_object("motion_queuing", None)
        self._update()

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
        self.reasons.add("command")
        self._update()
        try:
            former(gcmd)
            if name == SET_SHAPER:
                self._note_shaper(gcmd)
        finally:
            self._set("command", False)

    def _note_shaper(self, gcmd: Any) -> None:
        """Leave the motion bare from a command on that turns the input shaper off."""
        hz = [gcmd.get_float(f"SHAPER_FREQ_{axis}", None) for axis in "XY"]
        if any(each is not None for each in hz):
            (self.reasons.discard if any(hz) else self.reasons.add)("unshaped file")

    def _next_file(self) -> None:
        self.tower = ""
        self._set("unshaped file", False)

    def _set(self, reason: str, off: bool) -> None:
        (self.reasons.add if off else self.reasons.discard)(reason)
        self._update()

    def _update(self) -> None:
        """Turn on or off what the state asks for, at rest."""
        wanted = self.kernel is not None and self.enabled and not self.reasons
        active = wanted and self.tower in ("", "on")
        unshaped = active or (wanted and self.tower == "off")
        if (active, unshaped) == (self.active, self.unshaped):
            return
        self.toolhead.flush_step_generation()
        if self.active and not active:
            self._give_back()
        if self.shaper is not None and unshaped != self.unshaped:
            (self.shaper.disable_shaping if unshaped else self.shaper.enable_shaping)()
        self.unshaped = unshaped
        if active and not self.active:
            self._take()
        self.active = active

    def _take(self) -> None:
        lib, former = self.native.lib, {id(one[0]): one for one in self.motors}
        motors = []
        for stepper in self.toolhead.get_kinematics().get_steppers():
            theirs = stepper.get_stepper_kinematics()
            _, known, ours = former.get(id(stepper), (None, None, None))
            if known != theirs:
                ours = lib.hframe_live_alloc(self.native.ours(theirs), self.taps)
                if ours != self.native.ffi.NULL:
                    ours = self.native.freed(ours)
                elif any(map(stepper.is_active_axis, "xy")):
                    raise self.printer.config_error(
                        f"[{NAME}] cannot move {stepper.get_name()}: convert files instead"
                    )
                else:
                    continue  # a motor of z
            motors.append((stepper, theirs, ours))
        for stepper, _, ours in motors:
            lib.hframe_live_begin(ours)
            stepper.set_stepper_kinematics(self.native.klippers(ours))
        self.motors = motors
        self._note_window(on=True)

    def _give_back(self) -> None:
        for stepper, theirs, ours in self.motors:
            self.native.lib.hframe_live_end(ours)
            stepper.set_stepper_kinematics(theirs)
        self._note_window(on=False)

    def _note_window(self, on: bool) -> None:
        """Tell Klipper how far steps depend on the path around them."""
        if self.queuing is not None and hasattr(self.queuing, "check_step_generation_scan_windows"):
            self.queuing.check_step_generation_scan_windows()
        elif self.motors:
            window = max(self.native.lib.hframe_live_window(one[2]) for one in self.motors)
            old_and_new = (window, 0.0) if on else (0.0, window)
            self.toolhead.note_step_generation_scan_time(*old_and_new)

    def _forget(self) -> None:
        for _, _, ours in self.motors if self.active else ():
            self.native.lib.hframe_live_reset(ours)

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
            numbers = self.kernel.numbers
            return (
                f"on: {1e3 * numbers['leaves']:.1f} um where {1e3 * numbers['without']:.0f} would "
                f"be, at most {numbers['deviation']:.2f} mm off the path"
            )
        return f"off: {', '.join(sorted(self.reasons)) or self.tower or 'ENABLE=0'}"

    def get_status(self, eventtime: float) -> dict[str, Any]:
        status: dict[str, Any] = {
            "enabled": self.enabled, "active": self.active, "off": sorted(self.reasons),
            "kernel": str(self.path) if self.kernel is not None else "",
        }  # fmt: skip
        if self.kernel is not None:
            clamped = [self.native.lib.hframe_live_clamped(one[2]) for one in self.motors]
            status |= {**self.kernel.names, **self.kernel.numbers}
            status["clamped"] = max(clamped, default=0)  # ms for which travel limited it
        return status


def load_config(config: Any) -> HframeLive:
    return HframeLive(config)
