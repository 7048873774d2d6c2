"""A simple firmware that plays a file for the checks, independent of the package.

It follows places, filament and modes of Klipper or Marlin. Arcs reach no further
than their ends; an unknown command does nothing. Marks (``;@7`` or ``M117 @7``) record its state.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import NamedTuple

MARK = re.compile(rb"^\s*(?:;|M117 |UNHEARD_OF )@(\d+)")
WORD = re.compile(rb"([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))?")
INCH = 25.4
UNSEEN = 0.1  # mm of filament that Klipper lets any move feed
SHORT = 2e-3  # mm; ends that are no further apart are one place, as they are written


class Stand(NamedTuple):
    """At a mark: its number, places (mm; None: unknown), filament so far, modes, absolute e.

    place: of the machine; reported: as the firmware reports it, after G92; moves: number made;
    way, fed: mm of the next, and of its filament.
    """

    number: int
    place: tuple[float | None, ...]
    reported: tuple[float | None, ...]
    filament: float
    modes: tuple[bool, bool]
    e: float
    moves: int = 0
    way: float = 0.0
    fed: float = 0.0


@dataclass
class Machine:
    """A machine that plays lines. ``least``, ``greatest``: of all places asked for, x y z.

    doubted: axes that a macro may have moved since; renamed: those whose place G92 then named, of
    which nobody knows any more where the bed is. named: those, and axes that G92 named before any
    move, as after homing.
    seconds: what its moves and pauses last at their feed rates, at least. standing: filament fed
    while it stood, mm; nearly: between ends no further apart than SHORT; sharpest: filament per
    mm of any straight move or arc; steepest: of those that feed more than UNSEEN; flow: the fastest
    filament of any move, mm/s. trace: way and filament from the beginning, after each move.
    """

    firmware: str
    place: list[float | None] = field(default_factory=lambda: [None, None, None])
    offset: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    e: float = 0.0
    filament: float = 0.0
    absolute: bool = True
    absolute_e: bool = True
    unit: float = 1.0
    stands: list[Stand] = field(default_factory=list)
    least: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    greatest: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    doubted: set[int] = field(default_factory=set)
    renamed: set[int] = field(default_factory=set)
    named: set[int] = field(default_factory=set)
    waiting: int = 0  # the first stand whose next move is not known
    trace: list[tuple[float, float]] = field(default_factory=lambda: [(0.0, 0.0)])
    feed: float = 25.0  # mm/s
    seconds: float = 0.0
    standing: float = 0.0
    nearly: float = 0.0
    flow: float = 0.0
    steepest: float = 0.0
    sharpest: float = 0.0

    def play(self, text: bytes) -> Machine:
        """Play all lines of a file."""
        ends = rb"\r\n|[\r\n]" if self.firmware == "marlin" else rb"\r?\n"
        for raw in re.split(ends, text.removeprefix(b"\xef\xbb\xbf")):
            self.line(raw)
        return self

    def line(self, raw: bytes) -> None:
        if mark := MARK.match(raw):
            e = self.e if self._e_absolute else 0.0
            modes = (self.absolute, self.absolute_e)
            reported = tuple(
                None if p is None else p - o for p, o in zip(self.place, self.offset, strict=True)
            )
            stand = Stand(
                int(mark[1]),
                tuple(self.place),
                reported,
                self.filament,
                modes,
                e,
                len(self.trace) - 1,
            )
            self.stands.append(stand)
            return
        # from each of 100 000 open parentheses, a search for the missing end takes half a minute
        code = re.sub(rb"\([^)]*\)", b"", raw) if b")" in raw else raw
        code = code.split(b";")[0].split(b"*")[0].strip()
        code = re.sub(rb"^[Nn]\s*\d+\s*", b"", code)
        head = re.match(rb"([GMgm])\s*0*(\d+)(?:\.(\d+))?", code)
        if not head:
            self.doubted |= {0, 1, 2} if raw.split(b";")[0].strip() else set()
            return
        name = f"{head[1].decode().upper()}{head[2].decode()}" + (
            f".{head[3].decode()}" if head[3] else ""
        )
        words = {
            letter.decode().upper(): float(value)
            for letter, value in WORD.findall(code[head.end() :])
            if value
        }
        self._do(name, words)

    @property
    def _e_absolute(self) -> bool:
        return self.absolute_e and (self.absolute or self.firmware != "klipper")

    def _do(self, name: str, words: dict[str, float]) -> None:
        if name in ("G0", "G1", "G2", "G3", "G5"):
            self._move(name, words)
        elif name in ("G90", "G91"):
            self.absolute = name == "G90"
            if self.firmware == "marlin":
                self.absolute_e = self.absolute
        elif name in ("M82", "M83"):
            self.absolute_e = name == "M82"
        elif name in ("G20", "G21"):
            self.unit = INCH if name == "G20" else 1.0
        elif name == "G92":
            self._set(words)
        elif name == "G4":
            self.seconds += max(words.get("P", 0.0) / 1e3, words.get("S", 0.0), 0.0)
        elif name == "G28":
            for axis, letter in enumerate("XYZ"):
                if letter in words or not words.keys() & set("XYZ"):
                    self.place[axis] = None

    def _move(self, name: str, words: dict[str, float]) -> None:
        if words.get("F", 0.0) > 0.0:
            self.feed = words["F"] * self.unit / 60.0
        before, filament = list(self.place), self.filament
        self._go(words)
        steps = [
            a - b
            for a, b in zip(self.place, before, strict=True)
            if a is not None and b is not None
        ]
        length, fed = math.hypot(*steps), self.filament - filament
        arc = self._round(name, words, before)
        self.seconds += (length or abs(fed)) / self.feed
        if words.keys() & set("XYZE"):
            waiting = self.stands[self.waiting :]
            self.stands[self.waiting :] = [s._replace(way=length, fed=fed) for s in waiting]
            self.waiting = len(self.stands)
            self.trace.append((self.trace[-1][0] + (arc or length), self.filament))
            self.flow = max(self.flow, abs(fed) * self.feed / (length or SHORT))
        if fed > UNSEEN and length < SHORT:
            self.nearly += fed  # or along a circle
        if name not in ("G0", "G1"):  # a spline's length is not known here
            self.sharpest = max(self.sharpest, fed / arc if arc else 0.0)
            return
        if fed > 0.0 and length > 0.0:
            self.sharpest = max(self.sharpest, fed / length)
        if fed > UNSEEN and length < 1e-9:
            self.standing += fed
        elif fed > UNSEEN:
            self.steepest = max(self.steepest, fed / length)

    def fed_before(self, stand: Stand, way: float) -> tuple[float, float]:
        """The least and the most filament within so many mm before it, back to a standstill."""
        end, filament = self.trace[stand.moves]
        least = most = filament
        for k in range(stand.moves, 0, -1):
            (s0, f0), (s1, f1) = self.trace[k - 1], self.trace[k]
            if s1 == s0 and f1 == f0:  # a move to where it is
                continue
            if end - s1 >= way or s1 == s0:
                break
            begun = max(s0, end - way)
            f = f0 + (f1 - f0) * (begun - s0) / (s1 - s0)
            least, most = min(least, f), max(most, f)
        return least, most

    def _round(self, name: str, words: dict[str, float], start: list[float | None]) -> float:
        """Length in the plane of an arc about the centre that is given; 0 of all else."""
        centre = [words.get(letter, 0.0) * self.unit for letter in "IJ"]
        ends = (*start[:2], *self.place[:2])
        if name not in ("G2", "G3") or not any(centre) or None in ends:
            return 0.0
        x, y, x_e, y_e = (end for end in ends if end is not None)
        begin, end = (
            math.atan2(-centre[1], -centre[0]),
            math.atan2(y_e - y - centre[1], x_e - x - centre[0]),
        )
        sweep = (end - begin if name == "G3" else begin - end) % math.tau
        return math.hypot(*centre) * (sweep if math.dist((x, y), (x_e, y_e)) > 0.0 else math.tau)

    def _go(self, words: dict[str, float]) -> None:
        for axis, letter in enumerate("XYZ"):
            if letter in words:
                value, now = words[letter] * self.unit, self.place[axis]
                if self.absolute:
                    now = value + self.offset[axis]
                elif now is not None:
                    now += value
                self.place[axis] = now
                if self.absolute:
                    self.doubted.discard(axis)
                if now is not None and self.absolute and axis not in self.renamed:
                    self.least[axis] = min(self.least[axis], now)
                    self.greatest[axis] = max(self.greatest[axis], now)
        if "E" in words:
            value = words["E"] * self.unit
            step = value - self.e if self._e_absolute else value
            self.e += step
            self.filament += step

    def _set(self, words: dict[str, float]) -> None:
        if self.firmware == "klipper" and not words.keys() & set("XYZE"):
            words = dict.fromkeys("XYZE", 0.0)
        for axis, letter in enumerate("XYZ"):
            place = self.place[axis]
            if letter in words and (place is None or axis in self.doubted):
                self.named.add(axis)
            if letter in words and place is not None:
                self.offset[axis] = place - words[letter] * self.unit
                self.renamed |= {axis} & self.doubted
        if "E" in words:
            self.e = words["E"] * self.unit
