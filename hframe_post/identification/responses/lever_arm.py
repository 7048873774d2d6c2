"""Racking from one sensor on the nozzle, by the lever arm of eq. 2.

A run in x with the gantry at x = p moves the nozzle in y by the lever arm times θ, and a sensor
rotated by a small ψ about the vertical adds its share of x. Per x commanded,

    H_y(p) = (p − x_c)·Gxθ + ψ·Gxx

is a straight line over p: its slope is Gxθ, whatever ψ; its offset gives x_c and ψ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.identification.responses.frequency_response import FrequencyResponse


@dataclass(frozen=True, slots=True)
class Line:
    """The straight line over places, (k,) frequencies each.

    slope: Gxθ (rad/mm). middle: the mean place, mm. at_middle (k,): H_y there.
    off: RMS deviation of the places from the line, relative to the part that varies with the
    place; beyond_noise: the same without the part that noise explains. over_noise: power of the
    slope over that of its noise. by_place: each place (mm), and the slope from it alone.
    """

    slope: FrequencyResponse
    middle: float
    at_middle: Complex
    off: float
    beyond_noise: float
    over_noise: float
    by_place: list[tuple[float, FrequencyResponse]]


def line(places: Sequence[float], responses: Sequence[FrequencyResponse]) -> Line:
    """Fit the line by least squares to H_y (k,) at two places (mm) or more."""
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
    by_arm = np.outer(arm, slope)
    off = H - at_middle - by_arm
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
            if abs(a) >= 10.0  # mm; a place nearer the middle shows nothing of the slope
        ],
    )


def centre(line: Line, Gxx: Complex) -> tuple[float, float]:
    """Return x_c (mm) and ψ (rad) from the line's offset. Gxx (k,): as measured."""
    weight = np.sqrt(line.slope.power)
    columns = np.column_stack([line.slope.H, Gxx]) * weight[:, None]
    target = line.at_middle * weight
    stacked = np.concatenate([columns.real, columns.imag])
    (arm, psi), *_ = np.linalg.lstsq(stacked, np.concatenate([target.real, target.imag]))
    return line.middle - float(arm), float(psi)


def _noise(response: FrequencyResponse) -> Array:
    """Return the power that the command does not explain, per power of the command, (k,)."""
    coherence = np.clip(response.coherence, 1e-12, 1.0)
    noise: Array = (1.0 / coherence - 1.0) * np.abs(response.H) ** 2
    return noise
