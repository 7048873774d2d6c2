"""Racking from one sensor on the nozzle, by the lever arm of eq. 2.

A run in x with the gantry at x = p moves the nozzle in y by the lever arm times θ, and a sensor
turned by a small ψ about the vertical adds its share of x. Per x commanded,

    H_y(p) = (p − x_c)·Gxθ + ψ·Gxx

is a straight line over p: its slope is Gxθ, whatever ψ; where it begins tells x_c and ψ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.identification.responses.frequency_response import FrequencyResponse

ARM = 10.0  # mm from the middle place, below which a place alone tells nothing of the slope


@dataclass(frozen=True, slots=True)
class Line:
    """The straight line over places, (k,) frequencies each.

    slope: Gxθ (rad/mm). middle: the mean place, mm. at_middle (k,): H_y there.
    off: RMS of what the places are off the line, of the part that depends on the place;
    beyond_noise: the same without what noise explains. over_noise: power of the slope over that
    of its noise.
    by_place: each place (mm) and the slope as it alone tells it, from the line's middle.
    """

    slope: FrequencyResponse
    middle: float
    at_middle: Complex
    off: float
    beyond_noise: float
    over_noise: float
    by_place: list[tuple[float, FrequencyResponse]]


def line(places: Sequence[float], responses: Sequence[FrequencyResponse]) -> Line:
    """The line of least squares through H_y at two places or more, each (k,)."""
    first = responses[0]
    p = np.asarray(places)
    middle = float(p.mean())
    arm = p - middle
    H = np.array([r.H for r in responses])
    weights = arm / (arm @ arm)
    averages = min(r.averages for r in responses)
    slope, at_middle = weights @ H, H.mean(axis=0)
    noise = np.array([_noise(r) for r in responses])
    power = np.mean([r.power for r in responses], axis=0)
    off = H - at_middle - np.outer(arm, slope)
    by_arm = np.outer(arm, slope)
    size = (power * np.abs(by_arm) ** 2).sum()
    off_line = (power * np.abs(off) ** 2).sum() / size
    by_noise = (power * noise).sum() * (1.0 - 2.0 / len(p)) / size
    slope_noise = (power * (weights**2 @ noise)).sum()

    def response(value: Complex, noise: Array) -> FrequencyResponse:
        signal = np.abs(value) ** 2
        coherence = np.divide(signal, signal + noise, out=np.zeros(len(signal)), where=signal > 0.0)
        return FrequencyResponse(first.hz, value, coherence, power, averages)

    return Line(
        response(slope, weights**2 @ noise),
        middle,
        at_middle,
        float(np.sqrt(off_line)),
        float(np.sqrt(max(off_line - by_noise, 0.0))),
        float((power * np.abs(slope) ** 2).sum() / max(slope_noise, np.finfo(float).tiny)),
        [
            (place, response((h - at_middle) / a, n / a**2))
            for place, a, h, n in zip(p.tolist(), arm.tolist(), H, noise, strict=True)
            if abs(a) >= ARM
        ],
    )


def centre(line: Line, Gxx: Complex) -> tuple[float, float]:
    """(x_c in mm, ψ in rad) from where the line begins. Gxx (k,): as measured."""
    weight = np.sqrt(line.slope.power)
    columns = np.column_stack([line.slope.H, Gxx]) * weight[:, None]
    target = line.at_middle * weight
    stacked = np.concatenate([columns.real, columns.imag])
    (arm, psi), *_ = np.linalg.lstsq(stacked, np.concatenate([target.real, target.imag]))
    return line.middle - float(arm), float(psi)


def _noise(response: FrequencyResponse) -> Array:
    """Power of what the command does not explain, per power of the command, (k,)."""
    coherence = np.clip(response.coherence, 1e-12, 1.0)
    noise: Array = (1.0 / coherence - 1.0) * np.abs(response.H) ** 2
    return noise
