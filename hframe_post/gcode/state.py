"""How a file is read, and what its lines so far decide about the next: place, modes, limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from hframe_post.arrays import Z
from hframe_post.errors import LimitError
from hframe_post.firmware.base import FirmwareLimits
from hframe_post.firmware.dialect import AdvanceChange, Dialect
from hframe_post.firmware.registry import firmware
from hframe_post.gcode.commands import Line, Vocabulary, Words
from hframe_post.printer.settings import Printer, Retraction, Travel
from hframe_post.stream.types import FileLimits, ModalState, Position

LimitSource = Literal["file", "file-all", "printer"]
Extrusion = Literal["absolute", "relative"]

AXES = "XYZE"
MIN_FEED_FACTOR = 0.01
LIMITS_THAT_MAY_BE_ZERO = {"M205", "SQUARE_CORNER_VELOCITY", "MINIMUM_CRUISE_RATIO"}


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What the reader must know in addition to the file.

    limits: which of the file's limits replace the printer's: those that its firmware obeys,
    all that are known, or none.
    extrusion: what E is before the first M82 or M83; None: detect it.
    travel: where the path may go; None: anywhere.
    retraction: what G10 and G11 do; None: only the firmware knows.
    start: the firmware's limits until the file sets others; None: it has none.
    note: takes what is strange in the file, by its kind.
    """

    dialect: Dialect
    limits: LimitSource = "file"
    extrusion: Extrusion | None = None
    travel: Travel | None = None
    vocabulary: Vocabulary = field(default_factory=Vocabulary.with_names)
    retraction: Retraction | None = None
    start: FirmwareLimits | None = None
    note: Callable[[str, str], object] = lambda *_: None

    @classmethod
    def from_printer(
        cls, printer: Printer, limits: LimitSource = "file", extrusion: Extrusion | None = None
    ) -> ReadOptions:
        """Return the options for a printer. Raises HframeError if its firmware is unknown."""
        own, names = firmware(printer), printer.firmware
        vocabulary = Vocabulary.with_names(names.harmless, names.returns, names.other_tools or ())
        return cls(
            own.reads(), limits, extrusion, printer.travel, vocabulary, printer.retraction,
            own.limits(),
        )  # fmt: skip

    def obeys(self, name: str) -> bool:
        """Return whether what a command sets replaces the printer's limits."""
        return self.limits == "file-all" or (self.limits == "file" and name in self.dialect.obeyed)


class Extent:
    """Smallest and largest x, y and z of a path, mm; infinite without ``travel``."""

    def __init__(self, travel: Travel | None) -> None:
        edges = (travel.x, travel.y, travel.z) if travel else (None,) * 3
        self._edges = [edge or (-math.inf, math.inf) for edge in edges]
        rounding = 1e-9  # mm
        self.smallest = [low - rounding for low, _ in self._edges]
        self.largest = [high + rounding for _, high in self._edges]

    def check(self, line: Line, axis: int, value: float) -> None:
        """Raise LimitError if x, y or z (``axis`` 0, 1, 2) is off the bed."""
        if self.smallest[axis] <= value <= self.largest[axis]:
            return
        low, high = self._edges[axis]
        bound = low if value < low else high
        name = "xyz"[axis]
        text = line.text.strip()[:80].decode("latin-1")
        raise LimitError(
            f"{name} of the path (mm)", value, bound, line.number,
            f"{text!r} leads {abs(value - bound):.6g} mm beyond it. Either the file was sliced for "
            f"another printer, or travel.{name} of the profile is too small.",
        )  # fmt: skip


class State:
    """The modal state of a file: lengths in mm, times in s, whatever the file's units.

    bed: where the path may go.
    position: x, y, z on the machine, and e, all filament since the start of the file.
    offset: position minus what the file calls it; G92 changes it.
    known: whether x, y and z are certain; homing or a macro may have moved the machine.
    e_mode_known: whether the file or the user has said if E is absolute.
    scale: mm per unit of the file. feed: F as the file gives it. factor: M220.
    acceleration, travel_acceleration: of moves with and without extrusion; corner: square-corner
    velocity; others: what else limits moves. They are the firmware's (``start``; infinite without)
    until the file sets others. advance, smooth_time: see ``ModalState``; setting: the ``digest`` of
    the line that set them last, -1 if that is not known. e_named: by G92, since the last macro.
    """

    def __init__(self, options: ReadOptions) -> None:
        self._dialect, self.endstops = options.dialect, options.dialect.soft_endstops
        self.bed = Extent(options.travel)
        self.absolute = self.xy_plane = True
        self.absolute_e = options.extrusion != "relative"
        self.e_mode_known = options.extrusion is not None
        self.scale = 1.0
        self.position: Position = (0.0, 0.0, 0.0, 0.0)
        self.offset: Position = (0.0, 0.0, 0.0, 0.0)
        self.known = [False, False, False]
        self._homed = [False, False, False]
        self._stops = True  # at soft endstops, as M211 S1 sets
        self.feed = 25.0  # mm/s, Klipper's before the first F
        self.factor = self._saved_factor = 1.0
        self.acceleration = self.travel_acceleration = self.corner = math.inf
        self.others = FileLimits()
        if (start := options.start) is not None:
            self.acceleration, self.travel_acceleration = start.printing, start.travel
            self.corner, self.others = start.corner, start.others
        self.advance: float | None = None
        self.smooth_time: float | None = None
        self.setting = -1
        self.e_named = False

    @property
    def speed(self) -> float:
        """Return the speed in mm/s that the next move asks for."""
        return self.feed * self.factor

    # ------------------------------------------------------------------ place

    def target(self, words: Words) -> Position:
        px, py, pz, pe = self.position
        ox, oy, oz, oe = self.offset if self.absolute else self.position
        if not self.absolute_e:
            oe = pe
        elif self._dialect.g90_sets_e:
            oe = self.offset[3]  # absolute, even if x, y and z are relative
        scale = self.scale
        return (
            px if (x := words.get("X")) is None else ox + x * scale,
            py if (y := words.get("Y")) is None else oy + y * scale,
            pz if (z := words.get("Z")) is None else oz + z * scale,
            pe if (e := words.get("E")) is None else oe + e * scale,
        )

    def within_endstops(self, end: Position) -> Position:
        """Return where soft endstops let a move of homed axes end."""
        for axis, (low, high) in enumerate(self.endstops if self._stops else ()):
            if self._homed[axis] and not low <= end[axis] <= high:
                end = _replaced(end, axis, min(max(end[axis], low), high))
        return end

    def set_endstops(self, words: Words) -> None:
        """Apply M211."""
        self._stops = bool(words.get("S", self._stops))

    def starts_known(self, words: Words) -> bool:
        """Return whether a move starts at a known place.

        z matters only if the move names it, or G92 renamed it: a stream would have to name it.
        """
        x, y, z = self.known
        return x and y and (z or ("Z" not in words and not self.offset[Z]))

    def arrive(self, position: Position, words: Words) -> None:
        """Take over the end of a move from an unknown place: what it named absolutely is known."""
        self.position = position
        if self.absolute:
            x, y, z = self.known
            self.known = [x or "X" in words, y or "Y" in words, z or "Z" in words]

    def add_filament(self, filament: float) -> None:
        """Move e by a firmware retraction, which the file's own count does not include."""
        x, y, z, e = self.position
        ox, oy, oz, oe = self.offset
        self.position, self.offset = (x, y, z, e + filament), (ox, oy, oz, oe + filament)

    def forget(self, axes: Iterable[int] = range(3)) -> None:
        """Mark axes as unknown."""
        for axis in axes:
            self.known[axis] = False

    def home(self, arguments: bytes) -> list[int]:
        """Drop the offsets of the axes that G28 homes, and return them."""
        named = [k for k in range(3) if AXES[k].encode() in arguments.upper()]
        for axis in named or range(3):
            self.offset, self._homed[axis] = _replaced(self.offset, axis, 0.0), True
        return named or [0, 1, 2]

    def rename_position(self, line: Line, words: Words) -> None:
        """Apply G92: the file's name for the machine's place changes. Raises GcodeError."""
        values = words or (dict.fromkeys(AXES, 0.0) if self._dialect.g92_resets else {})
        axes = {AXES.index(letter): value * self.scale for letter, value in values.items()}
        known = [self.known[axis] for axis in axes if axis < 3]
        if any(known) and not all(known):
            raise line.error("G92 names known and unknown positions at once; use two lines")
        for axis, value in axes.items():
            if axis < 3 and not self.known[axis]:
                self.known[axis] = True
                self.position = _replaced(self.position, axis, value)
                self.offset = _replaced(self.offset, axis, 0.0)
            else:
                self.offset = _replaced(self.offset, axis, self.position[axis] - value)

    # ------------------------------------------------------------------ modes and limits

    def set_mode(self, name: str) -> None:
        if name in ("G90", "G91"):
            self.absolute = name == "G90"
            if self._dialect.g90_sets_e:
                self.set_e_mode(self.absolute)
        elif name in ("M82", "M83"):
            self.set_e_mode(name == "M82")
        elif name in ("G20", "G21"):
            self.scale = 25.4 if name == "G20" else 1.0
        else:
            self.xy_plane = name == "G17"

    def modes(self) -> dict[str, bool]:
        """Return whether each mode is set; its command changes nothing then."""
        absolute, e = self.absolute, self.absolute_e if self.e_mode_known else None
        g90 = absolute and (e is True or not self._dialect.g90_sets_e)
        g91 = not absolute and (e is False or not self._dialect.g90_sets_e)
        return {
            "G90": g90, "G91": g91, "M82": e is True, "M83": e is False,
            "G21": self.scale == 1.0, "G17": self.xy_plane,
        }  # fmt: skip

    def set_e_mode(self, absolute: bool) -> None:
        self.absolute_e, self.e_mode_known = absolute, True

    def set_feed(self, line: Line, value: float) -> None:
        """Apply F, in the file's units per minute. Raises GcodeError unless it is positive."""
        if value <= 0.0 and self._dialect.ignores_zero_feed:
            return
        feed = value * self.scale / 60.0
        if not 0.0 < feed < math.inf:
            raise line.error("the feed rate must be positive")
        self.feed = feed

    def set_factor(self, line: Line, arguments: bytes, words: Words) -> None:
        """Apply M220: S in percent; Marlin's B saves it, R restores it. Raises GcodeError."""
        letters = arguments.upper()
        if self._dialect.saves_factor and b"B" in letters:
            self._saved_factor = self.factor
        if self._dialect.saves_factor and b"R" in letters:
            self.factor = self._saved_factor
        without = self.factor if self._dialect.saves_factor else 1.0
        factor = words["S"] / 100.0 if "S" in words else without
        if factor < MIN_FEED_FACTOR:
            raise line.error(f"the speed factor must be at least {100.0 * MIN_FEED_FACTOR:g} %")
        self.factor = factor

    def set_limits(self, line: Line, name: str, words: Words) -> None:
        """Apply M201, M203, M204, M205 or SET_VELOCITY_LIMIT. Raises GcodeError near zero."""
        for word, value in words.items():
            if word == "R" and self.others.retract == math.inf:
                continue  # means nothing to this firmware
            velocity = name == "M203" or word == "VELOCITY"
            least = 0.1 if velocity else 1.0  # mm/s, mm/s²; below them a print would never end
            least = 0.0 if {name, word} & LIMITS_THAT_MAY_BE_ZERO else least
            if value < least:
                raise line.error(f"{word} must be at least {least:g}")
        if name == "M204":
            before = self.acceleration, self.travel_acceleration
            self.acceleration, self.travel_acceleration = self._dialect.accelerations(words, before)
            if self.others.retract < math.inf:
                self.limit(retract=words.get("R", self.others.retract))
        elif name == "M205" and self._dialect.has_deviation:
            self.limit(deviation=words.get("J", self.others.deviation))
        elif name == "M205":
            self.corner = min((words[a] for a in "XY" if a in words), default=self.corner)
        elif name == "M201":
            x, y, z, e = map(words.get, AXES, self.others.acceleration)
            self.limit(acceleration=(x, y, z, e))
        elif name == "M203":
            x, y, z, e = map(words.get, AXES, self.others.velocity)
            self.limit(velocity=(x, y, z, e))
        else:
            self.acceleration = self.travel_acceleration = words.get("ACCEL", self.acceleration)
            self.corner = words.get("SQUARE_CORNER_VELOCITY", self.corner)
            ratio = words.get("MINIMUM_CRUISE_RATIO", self.others.cruise_ratio)
            if (slower := words.get("ACCEL_TO_DECEL")) is not None:
                ratio = 1.0 - min(1.0, slower / self.acceleration)
            path = words.get("VELOCITY", self.others.path)
            self.limit(path=path, cruise_ratio=ratio)

    def set_advance(self, text: bytes) -> AdvanceChange:
        """Apply what a line sets of pressure advance, and return it."""
        change = self._dialect.advance(text)
        if change.seconds is not None:
            self.advance = change.seconds
        if change.smooth_time is not None:
            self.smooth_time = change.smooth_time
        if change != (None, None):
            self.setting = -1
        return change

    def limit(self, **limits: Any) -> None:
        """Change these of the other limits; they stay the same object where nothing changes."""
        if any(getattr(self.others, name) != value for name, value in limits.items()):
            self.others = replace(self.others, **limits)

    def modal_state(self) -> ModalState:
        e = self.position[3] - self.offset[3]
        return ModalState(
            self.absolute, self.absolute_e, e, self.feed, self.offset[:3], self.advance,
            self.smooth_time, self.travel_acceleration,
        )  # fmt: skip


def _replaced(position: Position, axis: int, value: float) -> Position:
    x, y, z, e = (value if k == axis else old for k, old in enumerate(position))
    return x, y, z, e
