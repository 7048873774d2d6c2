"""What several recordings share of a coupling: that alone is compensated.

Each run k is fitted by itself with the same modes, C_k. Over the runs

    C_k = Σ_j A_kj·β_j + e_k,    A = [1, x_k − x̄, y_k − ȳ]

a coupling is constant, or linear in the place where that foresees a run better that was left out.
What does not repeat, e, makes β uncertain, so that at each frequency only the share 1 − var(β)/|β|²
of it is known. What is known is fitted again.

A print is accelerated for times from a few ms to tenths of a second, so that its motion falls with
the square of the frequency. Responses are compared with that weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, Complex, X, Y
from hframe_post.identification.fitting.cross import (
    CrossFit,
    fit_coupling,
    fit_cross,
    foreseeing,
    with_own_modes,
)
from hframe_post.identification.fitting.modal import Modal
from hframe_post.identification.responses.crossed import Crossed
from hframe_post.identification.responses.full_response import LEAST_SPREAD

BETTER = 0.8  # times what a constant coupling leaves, from which one linear in place is believed
Axes = tuple[int | None, ...]


@dataclass(frozen=True, slots=True)
class CrossTerm:
    """A part of a coupling: constant, or per mm of place along an axis (0, 1) from ``centre``."""

    model: Modal
    along: int | None = None
    centre: float = 0.0

    def response(self, hz: Array, place: tuple[float, float]) -> Complex:
        """Return what it does at a place (x, y), mm, with the gain and delay of the model."""
        lever = 1.0 if self.along is None else place[self.along] - self.centre
        return lever * self.model.response(hz)


@dataclass(frozen=True, slots=True)
class Shared:
    """Runs, each with its fit C_k, and what they share.

    places (runs, 2): mm from ``centre``. axes: on what the coupling depends, None for its constant
    part. free: runs beyond those that the coupling needs. left: share of a run's response across
    that the others do not foresee, as a print weighs it, without noise and a turned sensor's share.
    """

    centre: Array
    places: Array
    axes: Axes
    models: list[Modal]
    fits: list[CrossFit]
    C: Complex
    hz: Array
    free: int
    left: float

    @property
    def at_mean(self) -> Modal:
        """Return the coupling at the mean place, with all that does not repeat."""
        return fit_coupling(self.C.mean(axis=0), self.hz, self.models)

    def terms(self) -> tuple[CrossTerm, ...]:
        """Return what is known of the coupling; empty if a further run would be needed."""
        if self.free < 1:
            return ()
        A = _design(self.places, self.axes)
        beta = np.linalg.pinv(A) @ self.C
        variance = (np.abs(self.C - A @ beta) ** 2).sum(axis=0) / self.free
        uncertain = np.linalg.inv(A.T @ A).diagonal()[:, None] * variance
        known = np.maximum(1.0 - uncertain / np.maximum(np.abs(beta) ** 2, 1e-300), 0.0)
        models = [fit_coupling(C, self.hz, self.models) for C in known * beta]
        return tuple(
            CrossTerm(model, axis, 0.0 if axis is None else float(self.centre[axis]))
            for model, axis in zip(models, self.axes, strict=True)
        )

    def size(self, term: CrossTerm) -> float:
        """Return what a term moves in a print, where it is largest, of the axis' own error."""
        along = self.models[0]
        late = np.exp(-2j * np.pi * self.hz * along.delay) * np.sinc(self.hz * TS) ** 2
        error = along.response(self.hz) - along.gain * late
        moved = in_print(term.model.response(self.hz), self.hz)
        arm = 1.0 if term.along is None else float(np.abs(self.places[:, term.along]).max())
        return arm * moved / in_print(error, self.hz)


def in_print(C: Complex, hz: Array) -> float:
    """Return the size of a response (k,) as a print weighs it."""
    return float(np.linalg.norm(C / hz**2))


def shared(runs: Sequence[Crossed], models: Sequence[Modal], known: int) -> Shared:
    """Return what the runs share, constant or linear in place.

    models: of the commanded axis, then others whose modes may take part. known: lever arms found
    from the same runs, which have been removed from them.
    """
    axes: Axes = (None,)
    best = _shared(runs, axes, models, known)
    for axis in (X, Y):
        spread = np.linalg.norm(best.places[:, axis])
        if spread < LEAST_SPREAD or best.free < 2 or (known and axis == X):
            continue
        linear = _shared(runs, (*best.axes, axis), models, known)
        best = linear if linear.left < BETTER * best.left else best
    return best


def _shared(runs: Sequence[Crossed], axes: Axes, models: Sequence[Modal], known: int) -> Shared:
    places = np.array([run.place for run in runs])
    centre = places.mean(axis=0)
    design, hz = _design(places - centre, axes), runs[0].along.hz
    kept = with_own_modes(runs, design, models)
    fits = [fit_cross(run, kept) for run in runs]
    C = np.array([fit.model.response(hz) for fit in fits])
    others = [foreseeing(design, k) @ C for k in range(len(runs))]
    left = sum(_power(run, C_k) for run, C_k in zip(runs, others, strict=True))
    whole = sum(_power(run, np.zeros(len(hz))) for run in runs)
    share = float(np.sqrt(max(left, 0.0) / whole)) if whole > 0.0 else 1.0
    free = len(runs) - len(axes) - known
    return Shared(centre, places - centre, axes, kept, fits, C, hz, free, share)


def _power(run: Crossed, C: Complex | Array) -> float:
    """Return what is left of a response across without C (k,), noise and the best turn."""
    weight = run.across.hz**-2.0
    D, left = weight * run.along.H, weight * (run.across.H - C)
    left = left - float(np.vdot(D, left).real / np.vdot(D, D).real) * D
    noise = weight * run.across.noise * np.abs(run.across.H)
    return float((np.abs(left) ** 2 - noise**2).sum())


def _design(places: Array, axes: Axes) -> Array:
    ones = np.ones(len(places))
    return np.column_stack([ones if axis is None else places[:, axis] for axis in axes])
