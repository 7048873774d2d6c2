"""The G-code that a firmware is sent around and between motions."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar

from hframe_post.arrays import Array
from hframe_post.stream.types import ModalState, Passthrough


class Code(ABC):
    """The G-code of a firmware on a printer.

    notices: warnings about how its files are sent. when_stopped: what to send after a print that
    was stopped midway, if it leaves the stream's settings behind.
    """

    when_stopped: ClassVar[str] = ""

    @property
    def notices(self) -> tuple[str, ...]:
        return ()

    @property
    def after_homing(self) -> list[str]:
        """Return the lines that a file of our own sends after G28, which may turn levelling off."""
        return []

    @abstractmethod
    def begin(self, offset: tuple[float, float, float], at: Array) -> list[str]:
        """Return the lines that change from the user's limits and modes to the stream's.

        offset: x, y, z of the user's G92; at (4,): x, y, z, e where the machine is.
        """

    @abstractmethod
    def end(self, state: ModalState, at: Array) -> list[str]:
        """Return the lines that restore the user's limits and the file's modes and places."""

    def around(self, move: Passthrough) -> tuple[list[str], list[str]] | None:
        """Return lines before and after a move of the file between which the user's limits hold.

        It is made as written, although the stream's modes hold. None: the machine must be released.
        """
        return None

    def modes_after(self, name: str, text: bytes) -> bytes:
        """Return lines that restore the stream's modes after a command of the file.

        name, text: of the command, and its whole line.
        """
        return {"G91": b"G90\n", "M82": b"M83\n"}.get(name, b"")  # where G90 leaves E as it is

    def reset_extruder(self, filament: float) -> bytes:
        """Return a line that resets the firmware's count of filament (mm), or nothing."""
        return b""

    @abstractmethod
    def set_limits(self, velocity: float, acceleration: float, corner: float) -> list[str]:
        """Return lines that set limits of moves as written, mm and s, and turn shaping off.

        corner: speed through a right angle.
        """

    def corner_range(self, acceleration: float) -> tuple[float, float]:
        """Return the speeds through a right angle between which ``set_limits`` can choose."""
        return 0.0, math.inf


def plain(value: float, decimals: int) -> str:
    """Return a number without exponent, trailing zeros or negative zero."""
    text = f"{value:.{decimals}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def coordinates(offset: tuple[float, float, float], at: Array) -> list[str]:
    """Return G92 for the place ``at``, with the axes whose offset is not 0."""
    words = [f"{a}{plain(p, 3)}" for a, p, o in zip("XYZ", at, offset, strict=False) if o]
    return [" ".join(["G92", *words])] if words else []


def modes(state: ModalState) -> list[str]:
    """Return the lines that restore a file's feed rate and modes, where G91 leaves E as it is."""
    lines = [f"G1 F{plain(state.feed * 60.0, 1)}"]
    if state.absolute_e:
        lines += ["M82", f"G92 E{plain(state.e, 5)}"]
    if not state.absolute:
        lines.append("G91")
    return lines
