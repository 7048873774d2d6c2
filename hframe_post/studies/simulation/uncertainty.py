"""Random printers that differ a little from the model.

Frequency and damping of each transfer function's roots, in the s-plane s = ln(z)/Ts, are scaled by
random factors. Poles and zeros move together, as they do when a belt gets tighter or a carriage
heavier, so that a slow pole keeps the zero that almost cancels it. Gxx(1) = Gyy(1) = 1 stays: a
nozzle at rest is where its steps put it. Only the gains of couplings are random.

A measured response takes more or less time, and decays faster or slower.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import ArgumentError
from hframe_post.model.impulse_response import ImpulseResponse, Linear
from hframe_post.model.plant import Plant
from hframe_post.model.transfer_function import REAL_TOLERANCE, TransferFunction


def draws(plant: Plant, share: float, count: int, seed: int) -> list[Plant]:
    """Return ``count`` random plants, parameters off by up to ``share`` (0.05: ±5 %), uniformly.

    Equal seeds give the same printers at every share, only farther off. Raises ArgumentError for
    a share that is not from 0 to below 1.
    """
    if not 0.0 <= share < 1.0:
        raise ArgumentError(f"a model error is a share from 0 to below 1, not {share:g}")
    rng = np.random.default_rng(seed)
    units = rng.uniform(-1.0, 1.0, (count, 3, 3))  # draw, transfer function, parameter
    cross = rng.uniform(-1.0, 1.0, (count, len(plant.cross), 3))
    units = np.concatenate([units, cross], axis=1)
    return [perturbed(plant, 1.0 + share * unit) for unit in units]


def perturbed(plant: Plant, factors: Array) -> Plant:
    """Return the plant with factors (k, 3) on frequency, damping and gain.

    They are those of Gxx, Gyy, Gxθ and, if any, the other couplings.
    """
    (fx, dx, _), (fy, dy, _), theta, *others = factors.tolist()
    Gxx, Gyy = _moved_axis(plant.Gxx, fx, dx), _moved_axis(plant.Gyy, fy, dy)
    Gxtheta = plant.Gxtheta and _moved_coupling(plant.Gxtheta, *theta)
    cross = (
        replace(coupling, G=_moved_coupling(coupling.G, *each))
        for coupling, each in zip(plant.cross, others, strict=True)
    )
    return replace(plant, Gxx=Gxx, Gyy=Gyy, Gxtheta=Gxtheta, cross=tuple(cross))


def _moved_axis(G: Linear, frequency: float, damping: float) -> Linear:
    if isinstance(G, ImpulseResponse):
        return _stretched(G, frequency, damping)
    moved = _moved(G, frequency, damping)
    return replace(moved, gain=moved.gain / moved.dc_gain)


def _moved_coupling(G: Linear, frequency: float, damping: float, gain: float) -> Linear:
    if isinstance(G, ImpulseResponse):
        return _stretched(G, frequency, damping).everywhere(
            lambda one: replace(one, deviation=gain * one.deviation, lag=gain * one.lag)
        )
    slope, moved = _slope(G), _moved(G, frequency, damping)
    scale = gain * slope / _slope(moved)
    return replace(moved, gain=moved.gain * scale)


def _stretched(G: ImpulseResponse, frequency: float, damping: float) -> ImpulseResponse:
    """Return a response whose frequencies are so many times as high, and whose modes decay faster.

    One rate of decay stands for those of all modes: half the inverse of the time around which the
    squared response lies, as for a single mode. The lag is a damper's, too.
    """
    if G.elsewhere:
        return G.everywhere(lambda one: _stretched(one, frequency, damping))
    moved = G.stretched(1.0 / frequency)
    t = np.maximum(np.arange(len(moved.deviation)) - moved.lead, 0)
    squared = np.square(moved.deviation)
    time = float(squared @ t)
    rate = 0.5 * float(squared.sum()) / time if time > 0.0 else 0.0
    deviation = np.exp((1.0 - damping) * rate * t) * moved.deviation
    return replace(moved, deviation=deviation, lag=damping * moved.lag)


def _moved(G: TransferFunction, frequency: float, damping: float) -> TransferFunction:
    zeros, poles = (_moved_roots(roots, frequency, damping) for roots in (G.zeros, G.poles))
    return TransferFunction(zeros, poles, G.gain)


def _moved_roots(roots: Complex, frequency: float, damping: float) -> Complex:
    """Return roots with scaled natural frequency and, if they ring, damping ratio.

    Roots at z ≤ 0 are delays or sampling artefacts, and stay; so does a root that would pass
    the Nyquist frequency.
    """
    moved = roots.copy()
    for k, z in enumerate(roots):
        if abs(z.imag) <= REAL_TOLERANCE and z.real <= 0.0:
            continue
        s = np.log(z)
        natural = abs(s)
        ratio = s.real / natural if natural else 0.0
        if abs(z.imag) > REAL_TOLERANCE:
            ratio = float(np.clip(damping * ratio, -0.999, 0.999))
        new = frequency * natural * (ratio + 1j * np.sign(s.imag) * np.sqrt(1.0 - ratio * ratio))
        if abs(new.imag) < np.pi:
            moved[k] = np.exp(new)
    return moved


def _slope(G: TransferFunction) -> float:
    """Return the gain at rest without the zeros at z = 1: θ per velocity."""
    moving = G.zeros[np.abs(G.zeros - 1.0) > 1e-6]
    return float((G.gain * np.prod(1.0 - moving) / np.prod(1.0 - G.poles)).real)
