"""Checks of an identified transfer function, as sentences for the user."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS
from hframe_post.model.transfer_function import TransferFunction

RINGING = 0.3  # damping below which a pair of poles is called a resonance
UNEXPLAINED = 2.0  # residual over noise from which an order is too low; of linear ones 1.6 at most
SETTLED = 0.01  # of a command's lead over a zero, below which it may be cut off
EARLIER = 0.1  # s of that lead that any window has to spare
COMMANDED = np.pi / 2.0  # rad a sample, 250 Hz, above which no command has anything to cancel
AT_BOUND = 0.01  # of the bounds' distance,
LOOSE = 1e-3  # s, where that is more than this


def of_roots(G: TransferFunction, band_hz: tuple[float, float]) -> list[str]:
    """Resonances outside the measured band."""
    texts = []
    for p in G.poles[G.poles.imag > 0.0]:
        hz, damping = natural(p)
        if damping < RINGING and not band_hz[0] <= hz <= band_hz[1]:
            texts.append(
                f"a resonance at {hz:.3g} Hz (damping {damping:.2g}) lies outside the measured "
                f"{band_hz[0]:g}–{band_hz[1]:g} Hz: it is a guess"
            )
    return texts


def of_zeros(G: TransferFunction) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """(notes, warnings) on zeros ζ outside the unit circle.

    The group delay that they cost, beyond that of zeros mirrored into the circle, is
    Σ (|ζ|² − 1) / |1 − ζ|² samples at rest. To cancel one the command must begin earlier, by
    what decays as |ζ|^−k over k samples: any preview does for the zeros of sampling, which lie
    far outside, and none does for one very near the circle. That of a delay's fraction of a
    sample may be so near, but at half the sampling rate, where nothing is commanded.
    """
    outside = G.zeros[np.abs(G.zeros) > 1.0 + 1e-9]
    if not len(outside):
        return (), ()
    excess = float(((np.abs(outside) ** 2 - 1.0) / np.abs(1.0 - outside) ** 2).sum())
    text = f"zeros outside the unit circle: {1e3 * TS * excess:.2g} ms of group delay"
    slow = np.abs(outside[np.abs(np.angle(outside)) < COMMANDED])
    earlier = float(TS * np.log(1.0 / SETTLED) / np.log(slow.min(initial=np.inf)))
    if earlier <= EARLIER:
        return (f"{text}, which preview cancels",), ()
    return (), (f"{text}; to cancel them commands must begin {1e3 * earlier:.0f} ms early",)


def of_delay(delay: float, bounds: tuple[float, float]) -> list[str]:
    """A delay (s) at its bound, where that is not but a sample of the sensor away."""
    low, high = bounds
    if high - low > LOOSE and min(delay - low, high - delay) < AT_BOUND * (high - low):
        return [
            f"the delay of {1e3 * delay:.3g} ms is at its bound: the recording does not start "
            "where it was thought to, or the order is wrong"
        ]
    return []


def of_order(order: int, over: float) -> list[str]:
    """An order too low: a residual ``over`` times the noise."""
    if over <= UNEXPLAINED:
        return []
    return [
        f"order {order} is too low, or the printer is not linear: the residual is "
        f"{over:.1f} times what the noise explains"
    ]


def natural(pole: complex) -> tuple[float, float]:
    """Natural frequency (Hz) and damping ratio of a pole of z; that of a real one is 1."""
    s = np.log(complex(pole) if pole else 1e-300) / TS
    return float(abs(s) / (2.0 * np.pi)), float(-s.real / abs(s)) if s else 1.0
