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
OWN_DAMPING = (0.03, 0.08, 0.2)
OWN_FREQUENCIES = 24  # at which such a mode is tried
BETTER = 0.05, 0.01  # of what was unexplained, and of C, that a mode must add to be kept
FREQUENCIES = 250  # enough to search with


@dataclass(frozen=True, slots=True)
class CrossFit:
    """turn: ψ in rad. model: the rest of C, 0 at rest, with gain and delay of the commanded axis.

    unexplained: share of C that is left, by power.
    """

    turn: float
    model: Modal
    unexplained: float

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
    power = across.power / across.power.sum()
    unexplained = (power * np.abs(across.H - A @ x) ** 2).sum() / (
        power * np.abs(across.H) ** 2
    ).sum()
    return CrossFit(float(x[0]), model, float(np.sqrt(unexplained)))


def foreseen(fit: CrossFit, across: FrequencyResponse, along: FrequencyResponse) -> float:
    """Return the share of another recording of C that a model leaves, whatever its ψ."""
    power = across.power / across.power.sum()
    left = across.H - fit.model.response(across.hz)
    turn = (power * along.H.conj() * left).sum().real / (power * np.abs(along.H) ** 2).sum()
    left = left - turn * along.H
    whole = (power * np.abs(across.H) ** 2).sum()
    return float(np.sqrt((power * np.abs(left) ** 2).sum() / whole))


def with_own_modes(
    first: tuple[FrequencyResponse, FrequencyResponse],
    second: tuple[FrequencyResponse, FrequencyResponse],
    models: Sequence[Modal],
) -> list[Modal]:
    """Return the models and those modes of the coupling alone that both recordings show.

    first, second: responses across and along, on one delay and the same frequencies.
    """
    kept = list(models)
    left = foreseen(fit_cross(*first, kept), *second)
    low, high = first[0].hz[[0, -1]]
    thinned = [_thinned(response) for response in first]
    for _ in range(MOST_OWN):
        tried = [
            [*kept, _single(models[0], hz, zeta)]
            for hz in np.geomspace(1.5 * low, 0.98 * high, OWN_FREQUENCIES).tolist()
            for zeta in OWN_DAMPING
        ]
        best = int(
            np.argmin([fit_cross(thinned[0], thinned[1], each).model.cost for each in tried])
        )
        its_left = foreseen(fit_cross(*first, tried[best]), *second)
        if left - its_left < BETTER[0] * left + BETTER[1]:
            break
        kept, left = tried[best], its_left
    return kept


def _thinned(response: FrequencyResponse) -> FrequencyResponse:
    s = slice(None, None, max(1, len(response.hz) // FREQUENCIES))
    arrays = {name: getattr(response, name)[s] for name in ("hz", "H", "coherence", "power")}
    return replace(response, **arrays)


def _single(model: Modal, hz: float, zeta: float) -> Modal:
    omega = np.array([2.0 * np.pi * hz])
    delay = model.parameters.delay
    return replace(model, parameters=Parameters(omega, np.array([zeta]), np.zeros(0), delay))


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
