"""Runs of one transfer function that a sensor began to record a little early or late.

A delay by τ multiplies a response with e^{−jωτ}. Between runs of the same it shows as a
phase that grows with frequency, whatever the response.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array
from hframe_post.frf import FrequencyResponse, average

ROUNDS = 3  # the mean, from which delays are counted, sharpens with each


def delays(responses: Sequence[FrequencyResponse]) -> Array:
    """How late each is, (n,) in s, from their mean; the delays' own mean is 0.

    Of least squares over the phase, each frequency weighted with what is coherent of it.
    """
    late = np.zeros(len(responses))
    for _ in range(ROUNDS if len(responses) > 1 else 0):
        mean = average([advanced(r, by) for r, by in zip(responses, late, strict=True)])
        omega = 2.0 * np.pi * mean.hz
        for k, response in enumerate(responses):
            turned = np.angle(response.H * np.exp(1j * omega * late[k]) * mean.H.conj())
            weight = response.power * response.coherence * np.abs(mean.H) ** 2
            late[k] -= (weight * omega * turned).sum() / (weight * omega**2).sum()
        late -= late.mean()
    return late


def advanced(response: FrequencyResponse, seconds: float) -> FrequencyResponse:
    """The response as it would be had the recording begun ``seconds`` later."""
    return replace(response, H=response.H * np.exp(2j * np.pi * response.hz * seconds))
