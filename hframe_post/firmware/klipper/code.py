"""Klipper's G-code: the limits and modes of the stream, and those before and after it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from hframe_post.arrays import Array, E
from hframe_post.errors import PrinterError
from hframe_post.firmware.code import Code, coordinates, modes, plain
from hframe_post.firmware.klipper.ramps import SQUARE_CORNER_VELOCITY, StreamLimits
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import ModalState

STAND = "G4 P0"  # comes to rest without flushing the queue of the motors, as M400 would
LABELS = re.compile(  # of objects: Klipper's commands, and lines that hosts replace by them
    rb"EXCLUDE_OBJECT_(START|END)\b|M486\b|;\s*(stop )?printing object\b|;MESH:", re.IGNORECASE
)


@dataclass(frozen=True, slots=True)
class KlipperCode(Code):
    """Klipper's G-code. stream: the limits while it runs."""

    table: KlipperTable
    stream: StreamLimits

    @classmethod
    def from_printer(cls, printer: Printer) -> KlipperCode:
        """Return the G-code for this printer. Raises PrinterError without Klipper's table."""
        stream = StreamLimits.from_limits(printer.limits, printer.motors, printer.kinematics)
        return cls(table_of(printer), stream)

    @property
    def limits_of_stream(self) -> list[str]:
        """Return the commands that set the stream's limits, with input shaping off."""
        limits = self.stream
        return [
            _shaper((0.0, 0.0, 0.0)),
            _limit(limits.velocity, limits.acceleration, SQUARE_CORNER_VELOCITY, 0.0),
        ]

    def begin(self, offset: tuple[float, float, float], at: Array) -> list[bytes]:
        macro = self.table.begin_macro
        start = [macro] if macro else self.limits_of_stream
        return [line.encode() for line in [STAND, *start, "G90", "M83", *coordinates(offset, at)]]

    def end(self, state: ModalState, at: Array) -> list[bytes]:
        table, names = self.table, coordinates(state.offset, at[:E] - state.offset)
        corner, cruise = table.square_corner_velocity, table.minimum_cruise_ratio
        stop = [_limit(table.velocity, table.acceleration, corner, cruise)]
        shaped = table.shaper_freq_x, table.shaper_freq_y, table.shaper_freq_z
        if any(shaped):
            stop.append(_shaper(shaped))
        if table.end_macro:
            stop.append(table.end_macro)
        return [line.encode() for line in [STAND, *stop, *names, *modes(state)]]

    def labels_object(self, text: bytes) -> bool:
        return labels_object(text)

    def set_limits(self, velocity: float, acceleration: float, corner: float) -> list[str]:
        v, a = plain(velocity, 0), plain(acceleration, 0)
        return [
            "SET_INPUT_SHAPER SHAPER_FREQ_X=0 SHAPER_FREQ_Y=0",
            f"SET_VELOCITY_LIMIT VELOCITY={v} ACCEL={a} MINIMUM_CRUISE_RATIO=0 "
            f"SQUARE_CORNER_VELOCITY={plain(corner, 2)}",
        ]

    def set_acceleration(self, acceleration: float) -> str:
        return f"SET_VELOCITY_LIMIT ACCEL={plain(acceleration, 0)}"

    def set_advance(self, seconds: float) -> str:
        return f"SET_PRESSURE_ADVANCE ADVANCE={plain(seconds, 5)}"


def table_of(printer: Printer) -> KlipperTable:
    """Return Klipper's own limits. Raises PrinterError if the profile has none."""
    if (table := printer.firmware.klipper) is None:
        cause = "the table is missing: Klipper's own limits"
        raise PrinterError(cause, "firmware.klipper", printer.name)
    return table


def labels_object(text: bytes) -> bool:
    return LABELS.match(text.lstrip()) is not None


def _shaper(frequencies: Iterable[float]) -> str:
    """Return the command for x, y and z; a Klipper that does not shape z ignores its frequency."""
    axes = zip("XYZ", frequencies, strict=True)
    return " ".join(["SET_INPUT_SHAPER", *(f"SHAPER_FREQ_{a}={plain(f, 6)}" for a, f in axes)])


def _limit(velocity: float, acceleration: float, corner: float, cruise_ratio: float) -> str:
    return (
        f"SET_VELOCITY_LIMIT VELOCITY={plain(velocity, 6)} ACCEL={plain(acceleration, 6)} "
        f"SQUARE_CORNER_VELOCITY={plain(corner, 6)} MINIMUM_CRUISE_RATIO={plain(cruise_ratio, 6)}"
    )
