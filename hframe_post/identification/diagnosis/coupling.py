"""What a command in one axis does to the other, as far as several recordings show it alike.

On a published CoreXY what x does to y came back the next day, on another one it did not. What does
not repeat is reported, and not compensated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hframe_post.arrays import TS, X, Y
from hframe_post.identification.estimation.estimated import Estimated
from hframe_post.identification.estimation.shared import in_print, shared
from hframe_post.identification.responses.crossed import Crossed
from hframe_post.model.plant import Coupling

REPEATS = 0.7  # share of a recording's coupling that the others may fail to foresee
LEAST_SHARE = 0.02  # of the axis' own error in a print, from which a coupling is compensated
LEAST_SIZE = 0.06  # of the command, below which there is none, unless it is compensated
TURNED = np.radians(2.0)  # by which a sensor is turned before the report says so


@dataclass(frozen=True, slots=True)
class MeasuredCoupling:
    """What a command in ``axis`` does to ``other``, x or y.

    runs: without what a turned sensor sees. gain: of the sensor. terms: what they share, to be
    compensated. turn: rad by which the sensor is turned, at the most. hz, size, wrong: where the
    coupling is greatest, how great, and |G − 1| of the axis itself there. unexplained: share of the
    coupling of a recording that the others do not foresee; None if there are too few.
    """

    axis: str
    other: str
    runs: tuple[Crossed, ...]
    gain: float
    terms: tuple[Coupling, ...]
    turn: float
    hz: float
    size: float
    wrong: float
    unexplained: float | None

    @property
    def counts(self) -> bool:
        """Return whether several recordings show it alike."""
        return self.unexplained is not None and self.unexplained <= REPEATS

    def as_text(self) -> str:
        """Return one sentence for the report."""
        if not self.terms and self.size < LEAST_SIZE:
            return f"a command in {self.axis} does not move {self.other}"
        text = (
            f"a command in {self.axis} moves {self.other} by {self.size:.2f} at {self.hz:.0f} Hz, "
            f"{100 * self.size / self.wrong:.0f} % of {self.axis}'s own error there"
        )
        if self.unexplained is None:
            tests = f"two tests of {self.axis} alone show whether it repeats"
            return f"{text}; it is not compensated: {tests}"
        if not self.counts:
            differ = f"{100 * self.unexplained:.0f} % differ"
            return f"{text}; it does not repeat ({differ}) and is not compensated"
        repeats = f"it repeats within {max(100 * self.unexplained, 1.0):.0f} %"
        if not self.terms:
            return f"{text}; {repeats}, but is too small to be compensated"
        axes = [axis for axis in (X, Y) if any(term.along == axis for term in self.terms)]
        along = "".join(f" and changes along {'xy'[axis]}" for axis in axes)
        return f"{text}; {repeats}{along}, and is compensated"

    def warnings(self) -> list[str]:
        if abs(self.turn) < TURNED:
            return []
        return [
            f"the sensor is turned by {np.degrees(abs(self.turn)):.0f}° about the vertical: it "
            f"shows in {self.other} a constant share of {self.axis}, which is removed"
        ]

    def as_json(self) -> dict[str, Any]:
        return {
            "axis": self.axis, "other": self.other, "repeats": self.counts,
            "unexplained": self.unexplained, "hz": self.hz, "size": self.size,
            "axis_itself_off": self.wrong, "sensor_turned_deg": float(np.degrees(self.turn)),
        }  # fmt: skip


def find_coupling(
    axis: str, runs: Sequence[Crossed], along: Estimated, known: int = 0
) -> MeasuredCoupling:
    """Return what a command in ``axis`` (x or y) does to the other axis.

    runs: on one delay and the same frequencies. along: response of the axis itself, on that delay.
    known: lever arms that were found from the same runs, and have been removed from them.
    """
    found, omega = shared(runs, along, known), 2.0 * np.pi * TS * runs[0].across.hz
    repeats = found.left <= REPEATS
    # the mean of what changes, with the place or by itself, may be 0
    alike = repeats and len(found.axes) == 1
    sizes = np.abs(found.C.mean(axis=0, keepdims=True) if alike else found.C).max(axis=0)
    most, error = int(np.argmax(sizes)), along.G.response(omega) - 1.0
    moved, other = (Y, "y") if axis == "x" else (X, "x")
    least = LEAST_SHARE * in_print(error, omega)
    terms = [
        Coupling(moved, Y - moved, G, lever, 0.0 if lever is None else float(found.centre[lever]))
        for G, lever, size in zip(found.parts, found.axes, found.sizes, strict=False)
        if repeats and size > least
    ]
    straight = [
        replace(run, across=replace(run.across, H=run.across.H - turn * run.along.H))
        for run, turn in zip(runs, found.turns, strict=True)
    ]
    return MeasuredCoupling(
        axis, other, tuple(straight), along.gain, tuple(terms), float(max(found.turns, key=abs)),
        float(runs[0].across.hz[most]), float(sizes[most]), float(np.abs(error[most])),
        found.left if found.parts else None,
    )  # fmt: skip
