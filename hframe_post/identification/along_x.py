"""Do a printer's modes move with the gantry? The fitted model, refined at each place by itself.

A belt's free length, and with it its stiffness, may change along x. One model then serves the
places around the middle best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.identification.fit import Fit
from hframe_post.identification.frequency_response import FrequencyResponse
from hframe_post.identification.modal import Data, Modal, refined
from hframe_post.identification.weighting import modes_within, weights
from hframe_post.model.transfer_function import TransferFunction

MOVES = 0.02  # relative change of a frequency over the places that deserves a word,
STRAIGHT = 0.8  # of whose variance a straight line over x explains at least so much


@dataclass(frozen=True, slots=True)
class Moving:
    """The lowest mode that moves: Hz at the least and the greatest x (mm) of the places.

    there: the transfer functions at both.
    """

    hz: tuple[float, float]
    x: tuple[float, float]
    there: tuple[TransferFunction, TransferFunction]

    @property
    def told(self) -> str:
        """In words, without the consequence."""
        return (
            f"the printer changes along x: its mode of {self.hz[0]:.1f} Hz at x = "
            f"{self.x[0]:.0f} mm is one of {self.hz[1]:.1f} Hz at x = {self.x[1]:.0f} mm. The "
            "profile's one model is that of the middle"
        )


def moving(
    found: Fit, places: Sequence[tuple[float, FrequencyResponse]], band_hz: tuple[float, float]
) -> Moving | None:
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
        delay = model.place.delay
        data = Data(
            part.hz, part.H, weights(part), modes_within(band_hz), (delay - 1e-6, delay + 1e-6)
        )
        own.append(refined(data, model.structure, model.place))
    omega = np.array([one.place.omega for one in own])  # (places, modes)
    weight = np.abs(model.c) + np.abs(model.d)
    k = int(np.argmax(np.where(model.place.zeta < 0.7, weight, 0.0)))
    slope, middle = np.polyfit(x - x.mean(), omega[:, k], 1)
    left, right = x.min(), x.max()
    change = slope * (right - left) / middle
    explained = 1.0 - np.var(omega[:, k] - middle - slope * (x - x.mean())) / np.var(omega[:, k])
    if abs(change) < MOVES or explained < STRAIGHT:
        return None
    ends = [own[int(np.argmin(x))], own[int(np.argmax(x))]]
    first, last = (one.discrete(found.lag, one.gain) for one in ends)
    hz = [float((middle + slope * (at - x.mean())) / (2.0 * np.pi)) for at in (left, right)]
    return Moving((hz[0], hz[1]), (float(left), float(right)), (first, last))
