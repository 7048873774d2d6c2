"""What a file asks for, as our reader understands it, and whether another asks for the same."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.firmware.registry import FIRMWARES
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.stream.types import Handling, ModalState, MoveAtRest, Moves, Passthrough

FILAMENT = 2e-3  # mm
STAMP = b"; processed by hframe-post"
UNSEEN = 0.1  # mm of filament that Klipper lets any move feed
ROUNDED = 1e-3  # mm; G92 is written with three decimals
PLACE = 0.06  # mm from the path where the machine is released: what settles, and rounding
AT_REST = (b"UNHEARD_OF", b"_MACRO", b"PAUSE", b"G28", b"T0", b"T1")
IN_ORDER = (b";LAYER", b";TYPE", b"M117 ", *AT_REST)


@dataclass
class Print:
    """points: x, y, z, e of all ends. standing: filament fed at rest; steepest: fed per mm.

    place: where it ends; None: not known. stops: lines that run at rest, and filament until then.
    """

    points: list[Array] = field(default_factory=list)
    filament: float = 0.0
    standing: float = 0.0
    steepest: float = 0.0
    place: tuple[float, ...] | None = None
    modes: ModalState | None = None
    stops: list[tuple[bytes, float]] = field(default_factory=list)


def unstamped(output: bytes) -> bytes:
    """Return an output as a file like any other."""
    return b"".join(line for line in output.splitlines(keepends=True) if STAMP not in line)


def print_of(text: bytes, firmware: str = "klipper") -> Print:
    """Return what a file asks for. Raises HframeError."""
    asked = Print()
    options = ReadOptions(FIRMWARES[firmware].dialect, "printer", "absolute")
    for item in read(text.splitlines(keepends=True), options):
        if isinstance(item, Moves):
            steps = np.diff(item.points, axis=0)
            much = steps[steps[:, 3] > UNSEEN]
            fed = much[:, 3] / np.sqrt(np.square(much[:, :3]).sum(axis=1))
            asked.points.append(item.points)
            asked.filament += float(steps[:, 3].sum())
            asked.steepest = max(asked.steepest, float(fed.max(initial=0.0)))
            asked.place = tuple(item.points[-1, :3])
        elif isinstance(item, MoveAtRest):
            asked.filament += item.end[3] - item.start[3]
            asked.standing += item.end[3] - item.start[3]
            asked.place = item.end[:3]
        elif isinstance(item, Passthrough):
            asked.filament += item.filament
            asked.place = None if item.cause else asked.place
            asked.modes = item.state
            if item.handling is Handling.RELEASE and item.text.startswith(AT_REST):
                asked.stops.append((item.text.rstrip(), asked.filament))
    return asked


def assert_same_print(text: bytes, output: bytes, firmware: str) -> None:
    """Assert equal filament at each stop, end, modes and order of lines of a file and output."""
    asked, written = print_of(text, firmware), print_of(unstamped(output), firmware)
    assert written.filament == pytest.approx(asked.filament, abs=FILAMENT)
    assert [line for line, _ in written.stops] == [line for line, _ in asked.stops]
    for (line, now), (_, then) in zip(written.stops, asked.stops, strict=True):
        assert now == pytest.approx(then, abs=FILAMENT), line
    if asked.place and written.place:
        assert written.place == pytest.approx(asked.place, abs=PLACE)
    assert asked.modes is not None
    assert written.modes is not None
    for mode in ("absolute", "absolute_e"):
        assert getattr(written.modes, mode) == getattr(asked.modes, mode)
    assert written.modes.offset == pytest.approx(asked.modes.offset, abs=ROUNDED)
    rest = iter(output.splitlines())
    for line in text.splitlines():
        if line.startswith(IN_ORDER):
            assert line in rest, f"{line!r} is lost or out of order"
