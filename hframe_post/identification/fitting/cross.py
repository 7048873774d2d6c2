"""What a command in one axis does to the other: a turned sensor, and coupling by shared modes.

    C(f) = ψ·D(f) + e^{−sτ}·sinc²(f·Ts)·Σ (c_i + d_i p_i) / (p_i² + 2ζ_i p_i + 1)
    p_i = s/ω_i,  Σ c_i = Σ d_i/ω_i = 0

=============  ==========================================================================
``C, D``       measured responses across and along the commanded axis
``ψ``          angle by which the sensor is turned about the vertical: its share of D is the same
               from rest on, while nothing couples at rest, and at a constant speed only what the
               damping of the modes explains
``ω_i, ζ_i``   modes of both axes, as their models have them
``c_i, d_i``   what each contributes across, by position and by speed
``τ``          delay of the commanded axis
=============  ==========================================================================

Only ψ, c and d are unknown, so this is one linear least-squares problem. A mode that neither axis
shows by itself, such as a head that nods, is added if it helps to foresee a second recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, optimize

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.fitting.modal import (
    Modal,
    Parameters,
    Structure,
    columns,
)
from hframe_post.identification.responses.crossed import Crossed
from hframe_post.identification.responses.frequency_response import FrequencyResponse

SAME_MODE = 0.04  # relative distance of frequencies below which both axes' models mean one mode
UNKNOWN = 0.05  # share of C, or of its RMS, that no linear model explains
MOST_OWN = 2  # modes of the coupling alone
OWN_DAMPING = (0.02, 0.06, 0.2)
OWN_FREQUENCIES = 20  # at which such a mode is tried
BETTER = 0.05, 0.01  # of what was unexplained, and of C, that a mode must add to be kept
FREQUENCIES = 250  # enough to search with


@dataclass(frozen=True, slots=True)
class CrossFit:
    """turn: ψ in rad. model: the rest of C, 0 at rest, with gain and delay of the axis itself."""

    turn: float
    model: Modal

    def coupling(self, run: Crossed) -> Complex:
        """Return the measured C (k,) without what the turned sensor sees of the commanded axis."""
        return np.asarray(run.across.H - self.turn * run.along.H)


def fit_cross(run: Crossed, models: Sequence[Modal]) -> CrossFit:
    """Return the model of the response across.

    models: of the commanded axis, whose delay holds, then of the other, if there is one.
    """
    turn, model = _fitted(run.across.H, _weight(run.across), run.across.hz, models, run.along.H)
    return CrossFit(turn, model)


def fit_coupling(C: Complex, hz: Array, models: Sequence[Modal]) -> Modal:
    """Return the model of a coupling C (k,) without noise, as exact where it moves a print."""
    return _fitted(C, hz**-2.0, hz, models, np.zeros(len(hz), complex))[1]


def _fitted(
    C: Complex, weight: Array, hz: Array, models: Sequence[Modal], along: Complex
) -> tuple[float, Modal]:
    """Return ψ, the share of ``along`` in C (k,), and the model of the rest."""
    structure, parameters = _shared_modes(models)
    s = np.asarray(2j * np.pi * hz)
    n = structure.modes
    unit = parameters.omega.min() / parameters.omega
    free = linalg.null_space([[*np.ones(n), *np.zeros(n)], [*np.zeros(n), *unit]])
    played = np.sinc(hz * TS) ** 2 * np.exp(-s * parameters.delay)
    modes = (columns(s, structure, parameters) @ free) * played[:, None]
    A: Complex = np.column_stack([along, modes])
    x = _least_squares(A * weight[:, None], weight * C)
    left = weight * (C - A @ x)
    cost, low_high = float((np.abs(left) ** 2).sum()), models[0].mode_range_hz
    return float(x[0]), Modal(structure, parameters, np.asarray(free @ x[1:]), cost, low_high)


def foreseen(runs: Sequence[Crossed], design: Array, models: Sequence[Modal]) -> float:
    """Return the share of the responses across, by power, that the other runs do not foresee.

    design (runs, m): what the coupling depends on, linearly; 1 for a constant. Each run has its own
    ψ, as its sensor may have turned.
    """
    fits = [fit_cross(run, models) for run in runs]
    left = whole = 0.0
    for k, (run, found) in enumerate(zip(runs, fits, strict=True)):
        weights = foreseeing(design, k)
        others = sum(
            weight * fit.model.response(run.across.hz)
            for weight, fit in zip(weights, fits, strict=True)
        )
        power = run.across.power
        left += float((power * np.abs(found.coupling(run) - others) ** 2).sum())
        whole += float((power * np.abs(run.across.H) ** 2).sum())
    return float(np.sqrt(left / whole))


def foreseeing(design: Array, k: int) -> Array:
    """Return the weights (runs,) with which the other runs foresee run k by least squares."""
    others = design.copy()
    others[k] = 0.0
    return np.asarray(design[k] @ np.linalg.pinv(others))


def with_own_modes(runs: Sequence[Crossed], design: Array, models: Sequence[Modal]) -> list[Modal]:
    """Return the models and those modes of the coupling alone that several runs show.

    runs: on one delay and the same frequencies. design: as for ``foreseen``.
    """
    kept = list(models)
    left = foreseen(runs, design, kept)
    thinned = [run.thinned(FREQUENCIES) for run in runs]
    for _ in range(MOST_OWN):
        tried = [*kept, _own_mode(thinned, kept)]
        its_left = foreseen(runs, design, tried)
        if left - its_left < BETTER[0] * left + BETTER[1]:
            break
        kept, left = tried, its_left
    return kept


def _own_mode(runs: Sequence[Crossed], models: Sequence[Modal]) -> Modal:
    """Return the mode that explains most of what the models leave."""
    low, high = np.log(runs[0].across.hz[[0, -1]])

    def mode(place: Array) -> Modal:
        hz, zeta = np.exp(place)
        omega, delay = np.array([2.0 * np.pi * hz]), models[0].parameters.delay
        parameters = Parameters(omega, np.array([zeta]), np.zeros(0), delay)
        return replace(models[0], parameters=parameters)

    def cost(place: Array) -> float:
        return sum(fit_cross(run, [*models, mode(place)]).model.cost for run in runs)

    starts = [
        np.array([hz, np.log(zeta)])
        for hz in np.linspace(low, high, OWN_FREQUENCIES)[1:-1].tolist()
        for zeta in OWN_DAMPING
    ]
    bounds = [(low, high), tuple(np.log([OWN_DAMPING[0], OWN_DAMPING[-1]]))]
    best = optimize.minimize(
        cost, min(starts, key=cost), method="Nelder-Mead", bounds=bounds, options={"maxfev": 60}
    )
    return mode(best.x)


def _shared_modes(models: Sequence[Modal]) -> tuple[Structure, Parameters]:
    """Return the modes of both axes that ring, without those that appear twice."""
    modes = list[tuple[float, float]]()
    for model in models:
        for omega, zeta in zip(model.parameters.omega, model.parameters.zeta, strict=True):
            if all(abs(omega / known - 1.0) > SAME_MODE for known, _ in modes):
                modes.append((float(omega), float(zeta)))
    omega, zeta = np.array(modes).T
    structure = Structure(len(modes), speed=True, zeros_at_rest=1)
    return structure, Parameters(omega, zeta, np.zeros(0), models[0].parameters.delay)


def _weight(across: FrequencyResponse) -> Array:
    size = np.abs(across.H)
    floor = UNKNOWN * np.hypot(size, np.sqrt(np.mean(size**2)))
    excited = across.power > 1e-3 * np.median(across.power)
    return np.asarray(excited / np.hypot(across.noise * size, floor + 1e-12))


def _least_squares(A: Complex, wanted: Complex) -> Array:
    """Return the real x (m,) for which A (k, m) times x comes nearest to ``wanted`` (k,)."""
    rows = np.concatenate([A.real, A.imag])
    scale = np.maximum(np.sqrt((rows**2).sum(axis=0)), 1e-300)
    target = np.concatenate([wanted.real, wanted.imag])
    return np.asarray(np.linalg.lstsq(rows / scale, target, rcond=1e-6)[0] / scale)
