"""How much a printer differs from place to place, and racking from sample to sample.

Modes may change with the gantry's position, since a belt's free length, and with it its stiffness,
changes along x. The response of all places together is stretched to what each shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from hframe_post.arrays import TS
from hframe_post.identification.responses.frequency_response import (
    FrequencyResponse,
    lowest,
    share_left,
)
from hframe_post.identification.responses.measured import centre, line
from hframe_post.model.impulse_response import ImpulseResponse

SAMPLES = 12  # of racking, with as much noise added as the coherence tells
DAY_TO_DAY = 0.05  # relative change of a printer as belts, bearings and temperature change
MOST = 0.2  # a model that scatters by more is wrong in another way
SCATTER = 0.002  # of the frequencies from run to run, relative
COUNTED_AS = 4  # positions that this usual scatter is worth
LEAST_SHIFT = 0.01  # over all positions
CHANCE = 1e-3  # that a shift is only noise
FACTORS = np.exp(np.arange(-0.3, 0.3001, 0.004))  # of frequencies, that are tried


def lever_arm_uncertainty(
    places: Sequence[float], responses: Sequence[FrequencyResponse], Gxx: FrequencyResponse
) -> tuple[float, float]:
    """Return standard deviations of x_c (mm) and of racking (relative), found by the lever arm."""
    rng = np.random.default_rng(0)
    found = line(places, responses).slope
    centres, slopes = [], []
    for _ in range(SAMPLES):
        sample = line(places, [with_noise(response, rng) for response in responses])
        centres.append(centre(sample, Gxx.H)[0])
        size = (found.power * found.H.conj() * sample.slope.H).sum().real
        slopes.append(size / (found.power * np.abs(found.H) ** 2).sum())
    return float(np.std(centres)), float(np.std(slopes))


def with_noise(response: FrequencyResponse, rng: np.random.Generator) -> FrequencyResponse:
    """Return the response with random noise of the size that its coherence tells."""
    real, imaginary = rng.normal(size=(2, len(response.hz))) * np.sqrt(0.5)
    noise = response.noise * np.abs(response.H) * (real + 1j * imaginary)
    return replace(response, H=response.H + noise)


# ---------------------------------------------------------------------- along x


@dataclass(frozen=True, slots=True)
class ModeShift:
    """How the frequencies change along x.

    hz: the main resonance at the least and the greatest x (mm) that was measured.
    """

    hz: tuple[float, float]
    x: tuple[float, float]

    @property
    def message(self) -> str:
        return (
            f"the printer changes along x: a mode at {self.hz[0]:.1f} Hz for x = {self.x[0]:.0f} "
            f"mm lies at {self.hz[1]:.1f} Hz for x = {self.x[1]:.0f} mm"
        )


def find_mode_shift(
    G: ImpulseResponse, resonance_hz: float, places: Sequence[tuple[float, FrequencyResponse]]
) -> ModeShift | None:
    """Return how modes shift along x; None if they do not, or fewer than 3 positions tell.

    G: of all places together. places: (x in mm, response) of each run. A shift counts if it is
    above 1 % over the positions and has a chance of 0.1 % at most to be noise (Student's t). Three
    places lie close to any line by chance, so the scatter that is usual counts, too.
    """
    x = np.array([place for place, _ in places])
    if len(places) < 3 or np.ptp(x) == 0.0:
        return None
    change = np.array([_log_factor(G, response) for _, response in places])
    away, n = x - x.mean(), COUNTED_AS + len(x) - 2
    power = float(away @ away)
    slope = float(away @ change) / power
    off = change - change.mean() - slope * away
    sd = np.sqrt((COUNTED_AS * SCATTER**2 + float(off @ off)) / n / power)
    if abs(slope) * np.ptp(x) < LEAST_SHIFT or abs(slope) < stats.t.isf(CHANCE, n) * sd:
        return None
    ends = float(x.min()), float(x.max())
    first, last = (float(np.exp(change.mean() + slope * (end - x.mean()))) for end in ends)
    return ModeShift((first * resonance_hz, last * resonance_hz), ends)


def _log_factor(G: ImpulseResponse, measured: FrequencyResponse) -> float:
    """Return the logarithm of the factor of all frequencies with which G is most like a place."""
    hz = measured.hz
    fine = np.linspace(hz[0] / FACTORS[-1], hz[-1] / FACTORS[0], 4 * len(hz))
    H = G.response(2.0 * np.pi * TS * fine)

    def left(factor: float) -> float:
        at = hz / factor
        there = np.interp(at, fine, H.real) + 1j * np.interp(at, fine, H.imag)
        return share_left(there, measured, measured.power)

    return lowest(np.log(FACTORS), [left(factor) for factor in FACTORS.tolist()])
