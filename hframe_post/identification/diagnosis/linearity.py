"""Is it one linear machine? What of the sweep's harmonics goes along with a cause.

Motors step, and a sine in whole steps has harmonics, too: 1 to 2.6 % of the answer where a step is
20 µm, more than 10 µm of backlash make. But their phases are those of the place on the motor's
grid, and the sway takes the sweep across many steps: from window to window they go along with no
cause. So a harmonic counts as far as it goes along with one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.identification.diagnosis.causes import ORDER, Linear, Stage
from hframe_post.identification.fitting.weighting import Distortion
from hframe_post.identification.recordings.alignment import acceleration
from hframe_post.identification.responses.harmonics import LOWEST_HZ, Harmonics, harmonics

RUNS = 2  # of each axis, on which causes act
PLAYS = (0.01, 2)  # mm of play to begin with, and how often it is drawn nearer
TOLD = 0.004  # of the answer, from which harmonics that go along with a cause are worth a word:
LIKE = 0.5  # correlation with it, at least. Of whole steps it is 0.05 to 0.25, of a cause 0.7 to 1
STEPPED = 2.0  # of the answer by mm of a step: harmonics beyond these no steps explain
# what makes a response smaller, and would be taken for the sensor's gain. Friction turns its phase
# and is there in a print, too, and a belt's stiffness does nothing to slow motion
TAKEN_OUT = {"backlash"}
BIN_HZ = 1.0  # over which what is not linear is averaged
CAUSES = {
    "friction": "Coulomb friction of {size:.0f} mm/s²: clean and grease the rails, and see that "
    "no belt is too tight",
    "backlash": "backlash of {microns:.0f} µm: look for a loose belt, pulley or carriage",
    "hardening": "a belt or mount that gets stiffer the harder it is pulled: look for what "
    "is loose",
    "one-sided": "a belt or mount that is stiffer one way than the other: set the belts' tension",
}


@dataclass(frozen=True, slots=True)
class Swept:
    """An axis: each run's command (m,), mm along it, with its harmonics; the linear part."""

    runs: Sequence[tuple[Array, Harmonics]]
    printer: Linear


@dataclass(frozen=True, slots=True)
class Nonlinearity:
    """What was found. shares: axis → of its answer's amplitude that harmonics are; size: mm/s² of
    friction, mm of play. distortions: of what is measured, by axis."""

    cause: str
    shares: dict[str, float]
    size: float
    distortions: dict[str, Distortion]

    @property
    def share(self) -> float:
        """Of the worse axis."""
        return max(self.shares.values())

    @property
    def message(self) -> str:
        """For the user."""
        cause = CAUSES[self.cause].format(size=self.size, microns=1e3 * self.size)
        where = " and ".join(f"{100 * s:.1f} % in {axis}" for axis, s in self.shares.items())
        return f"the printer is not linear: a sine is answered by harmonics ({where}): {cause}"


@dataclass(frozen=True, slots=True)
class _Likeness:
    """Of an axis to a cause: correlation (0 … 1), its size, and what of the response it bends."""

    like: float
    size: float
    bent: Distortion


def nonlinearity(axes: Mapping[str, Swept], step: float) -> Nonlinearity | None:
    """What the harmonics tell. step: mm of belt, of the motors. None: nothing to tell."""
    shares: dict[str, float] = {}
    alike: dict[str, dict[str, _Likeness]] = {}
    for name, axis in axes.items():
        heard = Harmonics.from_runs([one for _, one in axis.runs])
        own = {k: heard.share(k) for k in (2, 3)}
        alike[name] = {cause: _likeness(axis, cause, own[ORDER[cause]]) for cause in CAUSES}
        along = {cause: own[ORDER[cause]] * one.like for cause, one in alike[name].items()}
        best = max(along, key=lambda cause: along[cause])
        whole = float(np.hypot(own[2], own[3]))
        if along[best] > max(TOLD, LIKE * own[ORDER[best]]) or whole > STEPPED * step:
            shares[name] = whole
    if not shares:
        return None
    weighed = {
        cause: sum((shares[name] * alike[name][cause].like) ** 2 for name in shares)
        for cause in CAUSES
    }
    cause = max(weighed, key=lambda name: weighed[name])
    size = max(alike[name][cause].size for name in shares)
    bent = {name: one[cause].bent for name, one in alike.items()}
    return Nonlinearity(cause, shares, size, bent)


def _likeness(axis: Swept, cause: str, share: float) -> _Likeness:
    """How well harmonics go along with a cause: correlation, without the noise."""
    some = axis.runs[:: max(1, -(-len(axis.runs) // RUNS))]
    stages = [(Stage(command, axis.printer), acceleration(command)) for command, _ in some]
    heard, order = Harmonics.from_runs([one for _, one in some]), ORDER[cause]
    used = heard.used(order)
    values = heard.amplitude[used, order - 1]
    size, rounds = PLAYS if cause == "backlash" else (1.0, 0)
    for again in range(rounds + 1):
        made = Harmonics.from_runs(
            [one for stage, u in stages if (one := harmonics(u, stage.acted(cause, size)))]
        )
        shape = made.amplitude[used, order - 1]
        power = float(np.vdot(shape, shape).real)
        along = float(np.vdot(shape, values).real)
        scale = max(along / power, 0.0) if power else 0.0
        if again < rounds and scale:
            size *= scale
    length = share * float(np.linalg.norm(heard.amplitude[used, 0])) * np.sqrt(power)
    like = float(np.clip(along / length, 0.0, 1.0)) if length else 0.0
    own = scale * made.amplitude[:, 1 if order == 2 else 0]  # a square makes none of the first
    sure = 1.0 - float(np.sqrt(1.0 - like * like)) if cause in TAKEN_OUT else 0.0
    return _Likeness(like, size * scale, _distortion(heard, own, sure))


def _distortion(heard: Harmonics, own: Complex, sure: float) -> Distortion:
    """What a cause makes (w,) of the motion's own frequency, by frequency."""
    inside = heard.hz > LOWEST_HZ
    hz, share = heard.hz[inside], (own / heard.amplitude[:, 0])[inside]
    bins = np.floor(hz / BIN_HZ)
    held = np.unique(bins)
    return Distortion(
        np.array([hz[bins == k].mean() for k in held]),
        np.array([share[bins == k].mean() for k in held]),
        sure,
    )
