"""Do a printer's modes move with the gantry? The fitted model, refined at each place by itself.

A belt's free length, and with it its stiffness, may change along x. One model then serves the
places around the middle best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from hframe_post.arrays import Array
from hframe_post.identification.fitting.fit import Fit
from hframe_post.identification.fitting.modal import Data, Modal, refined
from hframe_post.identification.fitting.weighting import Distortion, modes_within, weights
from hframe_post.identification.responses.frequency_response import FrequencyResponse
from hframe_post.model.transfer_function import TransferFunction

MOVES = 0.01  # relative change of a frequency over the places that deserves a word,
CHANCE = 1e-3  # that it is none, from which it is told
LATE = 1e-3  # s by which a place's delay may differ, as modes that move turn phases, too
COUNTS = 0.1  # of the gain, that a mode carries whose movement matters
RINGS = 0.7  # damping ratio of a mode whose frequency is one


@dataclass(frozen=True, slots=True)
class ModeShift:
    """The mode whose movement is known best: Hz at the least and the greatest x (mm) of the places.

    at_ends: the transfer functions at both.
    """

    hz: tuple[float, float]
    x: tuple[float, float]
    at_ends: tuple[TransferFunction, TransferFunction]

    @property
    def message(self) -> str:
        """In words, without the consequence."""
        return (
            f"the printer changes along x: its mode of {self.hz[0]:.1f} Hz at x = "
            f"{self.x[0]:.0f} mm is one of {self.hz[1]:.1f} Hz at x = {self.x[1]:.0f} mm"
        )


def position_spread(runs: Sequence[FrequencyResponse]) -> Distortion:
    """By how much places differ from their mean, by frequency: of that mean no more is known.

    Modes that move smear it, and a smeared resonance looks like several.
    """
    H = np.array([run.H for run in runs])
    mean = H.mean(axis=0)
    off = np.sqrt((np.abs(H - mean) ** 2).mean(axis=0)) / np.maximum(np.abs(mean), 1e-12)
    return Distortion(runs[0].hz, off.astype(complex), 0.0)


def find_mode_shift(
    found: Fit, places: Sequence[tuple[float, FrequencyResponse]], band_hz: tuple[float, float]
) -> ModeShift | None:
    """How the modes move over the places; None where they do not, or that cannot be told."""
    model = found.model
    if not isinstance(model, Modal) or len(places) < 3:
        return None
    x = np.array([place for place, _ in places])
    if np.ptp(x) == 0.0:
        return None
    own = []
    for _, response in places:
        part = response.within(band_hz)
        about = (model.place.delay - LATE, model.place.delay + LATE)
        data = Data(part.hz, part.H, weights(part), modes_within(band_hz), about)
        own.append(refined(data, model.structure, model.place))
    omega = np.array([one.place.omega for one in own])  # (places, modes)
    middle, slope, uncertain = _lines(x, omega)
    left, right = float(x.min()), float(x.max())
    counts = (np.abs(model.c) + np.abs(model.d) > COUNTS * model.gain) & (model.place.zeta < RINGS)
    moves = np.abs(slope) * (right - left) > MOVES * middle
    sure = np.abs(slope) / np.maximum(uncertain, 1e-12)
    sure = np.where(counts & moves, sure, 0.0)
    k = int(np.argmax(sure))
    if sure[k] < stats.t.isf(CHANCE, len(x) - 2):
        return None
    ends = [own[int(np.argmin(x))], own[int(np.argmax(x))]]
    first, last = (one.discrete(found.printer_delay, one.gain) for one in ends)
    hz = [float((middle[k] + slope[k] * (at - x.mean())) / (2.0 * np.pi)) for at in (left, right)]
    return ModeShift((hz[0], hz[1]), (left, right), (first, last))


def _lines(x: Array, omega: Array) -> tuple[Array, Array, Array]:
    """Straight lines through omega (places, modes) over x (places,): values in the middle, slopes,
    and standard deviations of the slopes, as what is off the lines tells them, (modes,) each."""
    away = x - x.mean()
    middle, power = omega.mean(axis=0), float(away @ away)
    slope = away @ omega / power
    off = omega - middle - np.outer(away, slope)
    return middle, slope, np.sqrt((off**2).sum(axis=0) / (len(x) - 2) / power)
