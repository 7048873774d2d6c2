"""What a command in one axis does to the other: only what several recordings share is compensated.

On a published CoreXY what x does to y came back the next day, on another one it did not.

    C_k(f) = g·e^{−2πifτ}·(ψ_k·D(z) + G_k(z)),  G = −lag·(1 − 1/z) + (z − 2 + 1/z)·Q(z)

=============  ==========================================================================
``C_k, D``     response across, measured in run k, and the axis' own, which is 1 at rest
``ψ_k``        angle by which the sensor is turned about the vertical: its share of D is the same
               from rest on, while nothing couples at rest, so that C/D shows it at low frequencies
``G_k``        coupling in run k: a response as along, but 0 at rest, regressed run by run
``g, τ``       gain and delay of the commanded axis
=============  ==========================================================================

Over the runs G_k = Σ_j A_kj·β_j + e_k,  A = [1, x_k − x̄, y_k − ȳ]: a coupling is constant, or
linear in the place where that foresees a run better that was left out. What does not repeat, e,
makes β uncertain: of its lag, and of its Q at each frequency, only 1 − var(β)/|β|² is known.

A print is accelerated for times from a few ms to tenths of a second, so that its motion falls with
the square of the frequency. Responses are compared with that weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.fft import irfft, rfft

from hframe_post.arrays import TS, Array, Complex, X, Y
from hframe_post.identification.estimation import known_start
from hframe_post.identification.estimation.frequency_response import (
    FrequencyResponse,
    advanced,
)
from hframe_post.identification.estimation.known_start import BEFORE, FINE, LONGEST, ended
from hframe_post.identification.estimation.measured import RunGroup
from hframe_post.identification.estimation.regression import Estimated, regress
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Coupling

LEAST_SPREAD = 14.0  # mm: two places that are 20 mm apart
ROCKING = 1.0 / 3.0  # of the lowest resonance, below which a frame rocks


@dataclass(frozen=True, slots=True)
class Crossed:
    """Responses along and across the commanded axis, around ``place`` (x, y), mm."""

    along: FrequencyResponse
    across: FrequencyResponse
    place: tuple[float, float]


def crossed(axis: int, group: RunGroup, band_hz: tuple[float, float]) -> list[Crossed]:
    """Return what each recording shows of a command in an axis, X or Y, within what is excited.

    A test along a diagonal does not tell what each of the two commands does.
    Far below the resonances the frame may rock on its table, and sideways, too: that is left out.
    """
    rocking = ROCKING * min(group.lowest_hz, band_hz[1])  # a stiff printer has no resonance
    low, high = group.excited_hz
    band = max(band_hz[0], low, rocking), min(band_hz[1], high)
    return [
        Crossed(run.response.within(band), run.across.within(band), run.point)
        for run in group.runs
        if run.across is not None and run.direction and run.direction[1 - axis] == 0.0
    ]


UNKNOWN = 0.02  # share of C, or of its RMS, that no linear model explains
TURN_SD, LAG_SD = 0.03, 0.3  # rad, after a rough one; samples
BELOW = 0.6  # of the resonance, below which a turned sensor shows
FEWEST = 20  # frequencies that this takes
BETTER = 0.8  # times what a constant coupling leaves, from which one linear in place is believed
MOST_MODES = 3

Axes = tuple[int | None, ...]


@dataclass(frozen=True, slots=True)
class Shared:
    """What runs share of a coupling.

    omega (k,): rad/sample, measured. turns (runs,): ψ. C (runs, k): G. axes: on what the coupling
    depends, None for its constant part. centre (2,): mm. arms (axes,): mm from it, at the most; 1
    for the constant part. parts: what is known, per mm or constant. left: share of a
    run that the others do not foresee.
    """

    omega: Array
    turns: Array
    C: Complex
    axes: Axes
    centre: Array
    arms: Array
    parts: tuple[ImpulseResponse, ...]
    left: float

    @property
    def sizes(self) -> list[float]:
        """Return what each part moves in a print, where it is largest."""
        return [
            float(arm) * in_print(G.response(self.omega), self.omega)
            for G, arm in zip(self.parts, self.arms, strict=False)
        ]


def shared(runs: Sequence[Crossed], along: Estimated, known: int) -> Shared:
    """Return what the runs share, constant or linear in place.

    along: response of the commanded axis. known: lever arms found from the same runs, which have
    been removed from them.
    """
    turns, each = zip(*(_regressed(run, along) for run in runs), strict=True)
    omega, places = 2.0 * np.pi * TS * runs[0].across.hz, np.array([run.place for run in runs])
    centre = places.mean(axis=0)
    C = np.array([G.response(omega) for G in each])
    axes: Axes = (None,)
    A = _design(places - centre, axes)
    left = _left(C, omega, A)
    for axis in (X, Y):
        free = len(runs) - len(axes) - known
        spread = np.linalg.norm(places[:, axis] - centre[axis])
        if spread < LEAST_SPREAD or free < 2 or (known and axis == X):
            continue
        linear = _design(places - centre, (*axes, axis))
        if (its_left := _left(C, omega, linear)) < BETTER * left:
            axes, A, left = (*axes, axis), linear, its_left
    free, arms = len(runs) - len(axes) - known, np.abs(A).max(axis=0)
    parts = _parts(each, A, free)
    return Shared(omega, np.array(turns), C, axes, centre, arms, parts, left)


def in_print(C: Complex, omega: Array) -> float:
    """Return the size of responses (…, k) as a print weighs them."""
    return float(np.linalg.norm(C / omega**2))


def _regressed(run: Crossed, along: Estimated) -> tuple[float, ImpulseResponse]:
    """Return ψ and G of one run."""
    rough = _turn(run, along.resonance_hz)
    C = replace(run.across, H=(run.across.H - rough * run.along.H) / along.gain)
    size = np.abs(run.across.H / along.gain)
    noise = np.hypot(run.across.noise, UNKNOWN) * size
    sd = np.hypot(noise, UNKNOWN * np.sqrt(np.mean(size**2)) + 1e-12) / np.sqrt(2.0)
    linear = known_start.Linear(advanced(C, along.delay), 0.0, LAG_SD)
    found = regress(linear.data(1.0 / sd, TURN_SD), most=MOST_MODES)
    # what does not vanish at rest is the turned sensor's, and so is its share of what D rings
    turn, lag = float(found.mean[0]), float(found.mean[1]) - float(found.mean[0]) * along.G.lag
    at = np.arange(-BEFORE, LONGEST, dtype=float)
    known = np.arange(len(along.G.deviation), dtype=float) - along.G.lead
    q = found.response(at) - turn * np.interp(at, known, along.G.deviation, 0.0, 0.0)
    return rough + turn, ImpulseResponse(q, BEFORE, rest=0.0, lag=lag)


def _turn(run: Crossed, resonance_hz: float) -> float:
    """Return ψ to TURN_SD: below the resonance C/D is ψ, and a coupling grows with f and f²."""
    hz, noise = run.across.hz, run.across.noise * np.abs(run.across.H)
    low = hz <= max(BELOW * resonance_hz, float(hz[min(FEWEST, len(hz) - 1)]))
    r = hz[low] / resonance_hz
    size = np.abs(run.along.H[low])
    weight = size / np.hypot(noise[low], UNKNOWN * size)
    columns = weight[:, None] * np.column_stack([np.ones(len(r)), r * r, 1j * r])
    wanted = weight * run.across.H[low] / run.along.H[low]
    A = np.concatenate([columns.real, columns.imag])
    return float(np.linalg.lstsq(A, np.concatenate([wanted.real, wanted.imag]), rcond=None)[0][0])


def _design(away: Array, axes: Axes) -> Array:
    ones = np.ones(len(away))
    return np.column_stack([ones if axis is None else away[:, axis] for axis in axes])


def _left(C: Complex, omega: Array, A: Array) -> float:
    """Return the share of C (runs, k) that each run's others do not foresee by least squares."""
    foreseen = []
    for k in range(len(C)):
        others = A.copy()
        others[k] = 0.0
        foreseen.append(A[k] @ np.linalg.pinv(others) @ C)
    return in_print(C - np.array(foreseen), omega) / max(in_print(C, omega), 1e-300)


def _parts(each: Sequence[ImpulseResponse], A: Array, free: int) -> tuple[ImpulseResponse, ...]:
    """Return what is known of β."""
    found = np.array([[G.lag, *rfft(G.deviation, FINE)] for G in each])
    beta = np.linalg.pinv(A) @ found
    variance = (np.abs(found - A @ beta) ** 2).sum(axis=0) / free
    uncertain = np.linalg.inv(A.T @ A).diagonal()[:, None] * variance
    known = beta * np.maximum(1.0 - uncertain / np.maximum(np.abs(beta) ** 2, 1e-300), 0.0)
    return tuple(
        ImpulseResponse(
            ended(irfft(one[1:], FINE)[:LONGEST]), BEFORE, rest=0.0, lag=float(one[0].real)
        )
        for one in known
    )


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
    coupling of a recording that the others do not foresee.
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
    unexplained: float

    @property
    def counts(self) -> bool:
        """Return whether the recordings show it alike."""
        return self.unexplained <= REPEATS

    def as_text(self) -> str:
        """Return one sentence for the report."""
        if not self.terms and self.size < LEAST_SIZE:
            return f"a command in {self.axis} does not move {self.other}"
        text = (
            f"a command in {self.axis} moves {self.other} by {self.size:.2f} at {self.hz:.0f} Hz, "
            f"{100 * self.size / self.wrong:.0f} % of {self.axis}'s own error there"
        )
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

    runs: two at least, on one delay and the same frequencies. along: response of the axis itself,
    on that delay. known: lever arms that were found from the same runs, and have been removed from
    them; each takes one more run.
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
        found.left,
    )  # fmt: skip
