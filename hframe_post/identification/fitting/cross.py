"""What a command in one axis does to the other: a turned sensor, and coupling by shared modes.

    C(f) = ψ·D(f) + e^{−sτ}·sinc²(f·Ts)·Σ (c_i + d_i p_i) / (p_i² + 2ζ_i p_i + 1),   Σ c_i = 0

=============  ==========================================================================
``C, D``       measured responses across and along the commanded axis
``ψ``          angle by which the sensor is turned about the vertical: its share of D is the same
               from rest on, while nothing couples at rest, hence Σ c_i = 0
``ω_i, ζ_i``   modes of both axes, as their models have them: p_i = s/ω_i
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
from scipy import optimize

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.fitting.modal import (
    Modal,
    Parameters,
    Structure,
    columns,
    free_directions,
)
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

    def coupling(self, across: FrequencyResponse, along: FrequencyResponse) -> Complex:
        """Return the measured C (k,) without what the turned sensor sees of the commanded axis."""
        return np.asarray(across.H - self.turn * along.H)


def fit_cross(
    across: FrequencyResponse, along: FrequencyResponse, models: Sequence[Modal]
) -> CrossFit:
    """Return the model of the response across, measured with that along on the same frequencies.

    models: of the commanded axis, whose delay holds, then of the other, if there is one.
    """
    structure, parameters = _shared_modes(models)
    s = np.asarray(2j * np.pi * across.hz)
    n = structure.modes
    free = free_directions(structure, parameters, np.repeat([1.0, 0.0], n))
    played = np.sinc(across.hz * TS) ** 2 * np.exp(-s * parameters.delay)
    modes = (columns(s, structure, parameters) @ free) * played[:, None]
    A: Complex = np.column_stack([along.H, modes])
    weight = _weight(across)
    x = _least_squares(A * weight[:, None], weight * across.H)
    left = weight * (across.H - A @ x)
    coefficients = np.asarray(free @ x[1:])
    model = Modal(
        structure, parameters, coefficients, float((np.abs(left) ** 2).sum()),
        models[0].mode_range_hz,
    )  # fmt: skip
    return CrossFit(float(x[0]), model)


def foreseen(
    first: tuple[FrequencyResponse, FrequencyResponse],
    second: tuple[FrequencyResponse, FrequencyResponse],
    models: Sequence[Modal],
) -> float:
    """Return the share of the second C, by power, that the coupling fitted to the first leaves.

    first, second: as for ``with_own_modes``; each has its own ψ, as its sensor may have turned.
    """
    across, along = second
    turn = fit_cross(across, along, models).turn
    left = across.H - turn * along.H - fit_cross(*first, models).model.response(across.hz)
    whole = (across.power * np.abs(across.H) ** 2).sum()
    return float(np.sqrt((across.power * np.abs(left) ** 2).sum() / whole))


def with_own_modes(
    first: tuple[FrequencyResponse, FrequencyResponse],
    second: tuple[FrequencyResponse, FrequencyResponse],
    models: Sequence[Modal],
) -> list[Modal]:
    """Return the models and those modes of the coupling alone that both recordings show.

    first, second: responses across and along, on one delay and the same frequencies.
    """
    kept = list(models)
    left = foreseen(first, second, kept)
    across, along = (_thinned(response) for response in first)
    for _ in range(MOST_OWN):
        tried = [*kept, _own_mode(across, along, kept)]
        its_left = foreseen(first, second, tried)
        if left - its_left < BETTER[0] * left + BETTER[1]:
            break
        kept, left = tried, its_left
    return kept


def _own_mode(
    across: FrequencyResponse, along: FrequencyResponse, models: Sequence[Modal]
) -> Modal:
    """Return the mode that explains most of what the models leave."""
    low, high = np.log(across.hz[[0, -1]])

    def mode(place: Array) -> Modal:
        hz, zeta = np.exp(place)
        omega, delay = np.array([2.0 * np.pi * hz]), models[0].parameters.delay
        parameters = Parameters(omega, np.array([zeta]), np.zeros(0), delay)
        return replace(models[0], parameters=parameters)

    def cost(place: Array) -> float:
        return fit_cross(across, along, [*models, mode(place)]).model.cost

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


def _thinned(response: FrequencyResponse) -> FrequencyResponse:
    s = slice(None, None, max(1, len(response.hz) // FREQUENCIES))
    arrays = {name: getattr(response, name)[s] for name in ("hz", "H", "coherence", "power")}
    return replace(response, **arrays)


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
