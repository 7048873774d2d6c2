"""Modes and places: where the words of a move lead on the machine."""

from __future__ import annotations

from collections.abc import Iterable

from hframe_post.gcode.commands import Dialect, Words
from hframe_post.gcode.options import Extrusion
from hframe_post.stream.types import ModalState, Position

INCH = 25.4
AXES = "XYZE"
Word = float | None  # a coordinate as the file gives it, or not at all


class Coordinates:
    """Where the file is and how it counts.

    position: x, y, z on the machine and e, all the filament since the start of the file, in
    mm. offset: position less what the file calls it, which G92 changes. known: whether x, y
    and z are certain, or a command may have moved the machine. e_told: whether the file, or
    the user (``extrusion``), has said what E is.
    """

    def __init__(self, dialect: Dialect, extrusion: Extrusion | None = None) -> None:
        self._g90_sets_e = dialect.g90_sets_e
        self._g92_resets = dialect.g92_resets
        self.absolute = self.absolute_e = self.xy_plane = True
        self.e_told = False
        if extrusion is not None:
            self.tell_e(extrusion == "absolute")
        self.scale = 1.0  # mm in the file's unit
        self.position: Position = (0.0, 0.0, 0.0, 0.0)
        self.offset: Position = (0.0, 0.0, 0.0, 0.0)
        self.known = (False, False, False)

    def target(self, x: Word, y: Word, z: Word, e: Word) -> Position:
        """Where a move with these words leads."""
        px, py, pz, pe = self.position
        ox, oy, oz, oe = self.offset if self.absolute else self.position
        if not self.absolute_e:
            oe = pe
        elif self._g90_sets_e:  # whatever G91 says of x, y and z
            oe = self.offset[3]
        scale = self.scale
        return (
            px if x is None else ox + x * scale,
            py if y is None else oy + y * scale,
            pz if z is None else oz + z * scale,
            pe if e is None else oe + e * scale,
        )

    def tell_e(self, absolute: bool) -> None:
        """What E is from now on."""
        self.absolute_e, self.e_told = absolute, True

    def set_mode(self, name: str) -> None:
        """G90, G91, M82, M83, G20, G21, G17, G18 or G19."""
        if name in ("G90", "G91"):
            self.absolute = name == "G90"
            if self._g90_sets_e:
                self.tell_e(self.absolute)
        elif name in ("M82", "M83"):
            self.tell_e(name == "M82")
        elif name in ("G20", "G21"):
            self.scale = INCH if name == "G20" else 1.0
        else:
            self.xy_plane = name == "G17"

    def allow(self, z: Word) -> bool:
        """Whether a move starts at a known place: z must be so only if the move goes there."""
        x_known, y_known, z_known = self.known
        return x_known and y_known and (z_known or z is None)

    def arrive(self, new: Position, x: Word, y: Word, z: Word) -> None:
        """After a move from an unknown place: what it gave absolutely is known."""
        self.position = new
        if self.absolute:
            given = (word is not None for word in (x, y, z))
            x_known, y_known, z_known = (a or b for a, b in zip(self.known, given, strict=True))
            self.known = (x_known, y_known, z_known)

    def forget(self, axes: Iterable[int] = range(3), homed: bool = False) -> None:
        """The machine may have moved; homing also undoes what G92 had named."""
        known, offset = list(self.known), list(self.offset)
        for axis in axes:
            known[axis] = False
            if homed:
                offset[axis] = 0.0
        self._set(known, offset, list(self.position))

    def redefine(self, words: Words) -> bool:
        """G92: the position stays, the file's name for it changes.

        False, and nothing changes, where it names known and unknown places at once.
        """
        values = words or (dict.fromkeys(AXES, 0.0) if self._g92_resets else {})
        axes = {AXES.index(letter): value * self.scale for letter, value in values.items()}
        unknown = [axis for axis in axes if axis < 3 and not self.known[axis]]
        if unknown and any(axis < 3 and self.known[axis] for axis in axes):
            return False
        known, offset, position = list(self.known), list(self.offset), list(self.position)
        for axis, value in axes.items():
            if axis in unknown:
                position[axis], offset[axis], known[axis] = value, 0.0, True
            else:
                offset[axis] = position[axis] - value
        self._set(known, offset, position)
        return True

    def _set(self, known: list[bool], offset: list[float], position: list[float]) -> None:
        self.known = (known[0], known[1], known[2])
        self.offset = (offset[0], offset[1], offset[2], offset[3])
        self.position = (position[0], position[1], position[2], position[3])

    def state(self, feed: float) -> ModalState:
        """What the file believes of the firmware, with its feed rate in mm/s."""
        e = self.position[3] - self.offset[3]
        return ModalState(self.absolute, self.absolute_e, e, feed, self.offset[:3])
