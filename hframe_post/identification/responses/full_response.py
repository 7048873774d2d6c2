"""The full response of the nozzle, 2 × 2, from runs in several directions and at several places.

A run along the unit vector d at the place p makes i = x and y respond with

    H_i(f) = Σ_j G_ij(f, p)·d_j
    G_ij(f, p) = G_ij(f, p̄) + Σ_c (p_c − p̄_c)·S_cij(f),    j, c = x, y

G_ij is what a command in j does to i, p̄ the mean place, and S its change per mm of the place: the
lever arm of racking, above all. At each frequency this is a linear problem with real columns d_j
and (p_c − p̄_c)·d_j, solved by least squares with the noise of each run. Runs along x and y tell
a column of G each, and so do both tests of belts, along (1, 1) and (1, −1), together. A slope is
free where places lie far enough apart; elsewhere it is 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.responses.frequency_response import (
    NOISE_FLOOR,
    FrequencyResponse,
    check_same_frequencies,
)

LEAST_SPREAD = 14.0  # mm: two places that are 20 mm apart


@dataclass(frozen=True, slots=True)
class DirectedRun:
    """A run along ``direction`` (x, y) of any length, around ``place`` (x, y), mm.

    x, y: responses of the nozzle per commanded acceleration along the direction. All runs have
    one common delay.
    """

    direction: tuple[float, float]
    place: tuple[float, float]
    x: FrequencyResponse
    y: FrequencyResponse


@dataclass(frozen=True, slots=True)
class FullResponse:
    """The matrix at the frequencies hz (k,).

    G (k, 2, 2): [i, j], what a command in j does to i at the place ``middle`` (mm), and its
    variance. slopes (k, 2, 2, 2): [c, i, j], 1/mm, change with x and y of the place; 0 where the
    runs do not tell. commanded: whether x, y were commanded; the other columns are 0. power (k,)
    and averages as in FrequencyResponse.
    """

    hz: Array
    G: Complex
    variance: Array
    slopes: Complex
    middle: tuple[float, float]
    commanded: tuple[bool, bool]
    power: Array
    averages: float

    def entry(self, moved: int, command: int) -> FrequencyResponse:
        """Return what a command in an axis (0: x, 1: y) does to another, or to itself."""
        H = self.G[:, moved, command]
        signal, noise = np.abs(H) ** 2, self.averages * self.variance[:, moved, command]
        coherence = np.divide(signal, signal + noise, out=np.zeros(len(H)), where=signal > 0.0)
        return FrequencyResponse(self.hz, H, coherence, self.power, self.averages)

    def at(self, place: tuple[float, float]) -> Complex:
        """Return the matrix (k, 2, 2) at a place (x, y), mm."""
        away = np.subtract(place, self.middle)
        return np.asarray(self.G + np.einsum("c,kcij->kij", away, self.slopes))


def full_response(runs: Sequence[DirectedRun]) -> FullResponse:
    """Return the matrix from runs on the same frequencies.

    Raises IdentificationError if all runs that move both axes have one direction: x and y cannot
    be told apart.
    """
    responses = [response for run in runs for response in (run.x, run.y)]
    check_same_frequencies(responses)
    directions = np.array([np.divide(run.direction, np.hypot(*run.direction)) for run in runs])
    places = np.array([run.place for run in runs])
    middle = places.mean(axis=0)
    names, A = _columns(directions, places - middle)
    hz, averages = responses[0].hz, min(response.averages for response in responses)
    G, variance = np.zeros((len(hz), 2, 2), complex), np.zeros((len(hz), 2, 2))
    slopes = np.zeros((len(hz), 2, 2, 2), complex)
    for i, responses in enumerate(([run.x for run in runs], [run.y for run in runs])):
        solution, covariance = _solved(A, responses)
        for column, (j, c) in enumerate(names):
            if c is None:
                G[:, i, j], variance[:, i, j] = solution[:, column], covariance[:, column]
            else:
                slopes[:, c, i, j] = solution[:, column]
    known = {j for j, _ in names}
    return FullResponse(
        hz, G, variance, slopes, (float(middle[0]), float(middle[1])), (0 in known, 1 in known),
        np.mean([response.power for response in responses], axis=0), averages,
    )  # fmt: skip


def _columns(directions: Array, away: Array) -> tuple[list[tuple[int, int | None]], Array]:
    """Return which entries are free, as (command, None or place coordinate), and their columns."""
    moved = [j for j in (0, 1) if np.abs(directions[:, j]).max() > 1e-6]
    A = directions[:, moved]
    names: list[tuple[int, int | None]] = [(j, None) for j in moved]
    if np.linalg.matrix_rank(A, 0.1) < len(moved):
        raise IdentificationError(
            "runs along one diagonal alone do not tell x from y. Add a run along the other "
            "diagonal (TEST_RESONANCES AXIS=1,-1 as well as AXIS=1,1), or one along x or y"
        )
    for j in moved:
        for c in (0, 1):
            column = directions[:, j] * away[:, c]
            free = column - A @ np.linalg.lstsq(A, column, rcond=None)[0]
            if np.linalg.norm(free) >= LEAST_SPREAD:
                A = np.column_stack([A, column])
                names.append((j, c))
    return names, A


def _solved(A: Array, responses: Sequence[FrequencyResponse]) -> tuple[Complex, Array]:
    """Return the unknowns and variances, (k, m) each, from responses to the columns (n, m)."""
    H = np.array([response.H for response in responses])
    noise = np.array([response.noise for response in responses]) * np.abs(H)
    # places are on a line no better than this share of the strongest of them
    least = NOISE_FLOOR * np.abs(H).max(axis=0) + 1e-9
    variance = noise**2 + least**2
    weighted = np.einsum("nm,nk->kmn", A, 1.0 / variance)
    inverse = np.linalg.inv(weighted @ A)
    solution = np.einsum("kml,kln,nk->km", inverse, weighted, H)
    return solution, np.einsum("kmm->km", inverse)
