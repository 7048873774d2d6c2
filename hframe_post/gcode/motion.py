"""Moves and curves of a G-code file: words of G0, G1, G2, G3 and G5 → gathered motion."""

from __future__ import annotations

import math

import numpy as np

from hframe_post.arrays import Array
from hframe_post.gcode import arcs
from hframe_post.gcode.batching import Gathering
from hframe_post.gcode.bed import Bed
from hframe_post.gcode.commands import Words
from hframe_post.gcode.coordinates import AXES, Coordinates, Word
from hframe_post.gcode.feed import Feed
from hframe_post.gcode.lexer import Line, plain_words
from hframe_post.gcode.limits import RequestedLimits
from hframe_post.gcode.passthrough import Passing
from hframe_post.gcode.plain_moves import FARTHEST, MOST_FILAMENT, NO_PATH, STEEPEST
from hframe_post.stream.types import Handling, Position, Standing

MOST_TURNS = 100  # of an arc
SHORTEST = 1e-3  # mm that can be written
IMPOSSIBLE = 1e3  # mm of filament per mm of path
NOWHERE = [None] * 4  # the places of a line that only sets F
OUT_OF_BOUNDS = "a coordinate is out of all bounds"


class Motion:
    """Takes what lines ask the machine to move. ``any``: whether one did.

    splines: whether the firmware has G5.
    """

    def __init__(
        self, place: Coordinates, feed: Feed, bed: Bed, limits: RequestedLimits,
        items: Gathering, passing: Passing, splines: bool,
    ) -> None:  # fmt: skip
        self._place, self._feed, self._bed, self._limits = place, feed, bed, limits
        self._items, self._passing, self._splines = items, passing, splines
        self.any = False

    # ------------------------------------------------------------------ moves

    def plain(self, line: Line, words: tuple[bytes | None, ...]) -> None:
        """G0 or G1 with its words in the usual order: the hot path."""
        f, *places = plain_words(line, words)
        if f is not None:
            self._feed.set(line, f, self._place.scale)
        if places != NOWHERE:
            self.straight(line, *places)

    def straight(self, line: Line, x: Word, y: Word, z: Word, e: Word) -> None:
        """One straight move to the file's coordinates."""
        place = self._place
        old, new = place.position, self._target(line, x, y, z, e)
        if not place.allow(z):
            self._as_it_stands(line, new, math.dist(old[:3], new[:3]), (x, y, z))
        elif new[0] != old[0] or new[1] != old[1]:
            self._travel(line, new)
        elif new != old:
            if new[2] != old[2]:
                self._bed.check(line, 2, new[2])
            top = self._limits.axes.velocity[2 if new[2] != old[2] else 3]
            self._items.stand(Standing(line.number, old, new, min(self._feed.speed, top)))
            place.position = new

    def _target(self, line: Line, x: Word, y: Word, z: Word, e: Word) -> Position:
        """Where a move leads, on the bed or not."""
        if e is not None and not self._place.e_told:
            self._place.tell_e(self._passing.e_is_absolute(line))
        new = self._place.target(x, y, z, e)
        self.any = True
        if not (min(new) > -FARTHEST and max(new) < FARTHEST):
            raise line.error(OUT_OF_BOUNDS)
        if abs(new[3] - self._place.position[3]) > MOST_FILAMENT:
            raise line.error(f"more than {MOST_FILAMENT:g} mm of filament in one move")
        return new

    def _travel(self, line: Line, new: Position) -> None:
        """A move in which x or y travels joins the gathered ones."""
        x, y, z, e = new
        least, greatest = self._bed.least, self._bed.greatest
        if not (
            least[0] <= x <= greatest[0]
            and least[1] <= y <= greatest[1]
            and least[2] <= z <= greatest[2]
        ):
            for axis in range(3):
                self._bed.check(line, axis, new[axis])
        old = self._place.position
        path, filament = math.dist(old[:3], new[:3]), abs(e - old[3])
        if path < SHORTEST and filament > STEEPEST * path:  # then it is fed in one place
            speed = min(self._feed.speed, self._limits.axes.velocity[3])
            self._items.stand(Standing(line.number, old, (*old[:3], e), speed))
        elif filament > IMPOSSIBLE * path:
            raise line.error(f"{filament:.3g} mm of filament along {path:.3g} mm of path")
        elif path > NO_PATH:
            self._items.travel(line.number, old, new, self._feed.speed)
        self._place.position = new

    def _as_it_stands(
        self, line: Line, new: Position, path: float, words: tuple[Word, Word, Word]
    ) -> None:
        """A move from an unknown place goes to the firmware; what it names is known after it."""
        place = self._place
        if place.scale != 1.0:  # the output is in mm
            raise line.error("a move in inches from an unknown position")
        if place.absolute:
            for axis, word in enumerate(words):
                if word is not None:
                    self._bed.check(line, axis, new[axis])
        filament = new[3] - place.position[3]
        self._passing.line(
            line, Handling.RELEASE, filament=filament, path=path, cause=self._passing.cause
        )
        place.arrive(new, *words)

    # ------------------------------------------------------------------ curves

    def arc(self, line: Line, words: Words, ccw: bool) -> None:
        """G2 or G3. P counts the turns that it begins."""
        place = self._place
        if not place.xy_plane:
            raise line.error("arcs outside the x-y plane are not supported")
        turns = words.pop("P", 1.0) or 1.0
        if turns != int(turns) or not 1 <= turns <= MOST_TURNS:
            raise line.error(f"P must be a number of turns, 1 to {MOST_TURNS}")
        start = place.position
        x, y, z, e = (words.get(axis) for axis in AXES)
        new = self._target(line, x, y, z, e)
        ends = start[:2], new[:2]
        centre = None
        if "I" in words or "J" in words:
            i, j = (words.get(letter, 0.0) * place.scale for letter in "IJ")
            centre = start[0] + i, start[1] + j
        elif "R" in words:
            centre = arcs.centre_of_radius(*ends, words["R"] * place.scale, ccw)
        if not place.allow(z):  # then it cannot be checked either
            self._as_it_stands(line, new, math.dist(start[:3], new[:3]), (x, y, z))
            return
        arc = arcs.arc(*ends, centre, ccw, int(turns)) if centre else None
        if arc is None:
            raise line.error("the arc's centre or radius does not fit its ends")
        if not arc.length < FARTHEST:
            raise line.error(OUT_OF_BOUNDS)
        self._curve(line, new, *arc.chords())

    def spline(self, line: Line, words: Words) -> None:
        """G5: a cubic Bézier curve, its control points relative to its ends."""
        place = self._place
        start = place.position
        x, y, z, e = (words.get(axis) for axis in AXES)
        new = self._target(line, x, y, z, e)
        if not place.allow(z):
            if not self._splines:
                raise line.error("a spline from an unknown position")
            self._as_it_stands(line, new, math.dist(start[:3], new[:3]), (x, y, z))
            return
        i, j, p, q = (words.get(letter, 0.0) * place.scale for letter in "IJPQ")
        ends = (start[0], start[1]), (new[0], new[1])
        first, second = (ends[0][0] + i, ends[0][1] + j), (ends[1][0] + p, ends[1][1] + q)
        if max(map(abs, (*first, *second))) > FARTHEST:
            raise line.error(OUT_OF_BOUNDS)
        self._curve(line, new, *arcs.spline(ends[0], first, second, ends[1]))

    def _curve(self, line: Line, new: Position, points: Array, share: Array) -> None:
        """Chords to points (k, 2); z and e grow with the share (k,) of the curve."""
        _, _, z0, e0 = self._place.position
        z, e = z0 + share * (new[2] - z0), e0 + share * (new[3] - e0)
        rows = np.column_stack([points, z, e]).tolist()
        rows[-1] = new
        for row in rows:
            self._travel(line, tuple(row))
