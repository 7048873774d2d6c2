"""Harmonics of a sweep in the measured acceleration.

A linear printer answers a sine with a sine. The sweep's phase φ(t) is known, so the answer is
split into A_k(t) e^{jkφ} in short windows. Whatever lies at the half orders k + ½ is noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, hilbert, sosfiltfilt

from hframe_post.arrays import TS, Array, Complex, Flags
from hframe_post.identification.recordings.clock_sync import find_marks, moving_samples

WINDOW, HOP = 1000, 500  # samples
LOWEST_HZ = 5.0  # below it the orders overlap
HIGHEST_HZ = 240.0  # up to which recordings have a flat response


@dataclass(frozen=True, slots=True)
class Harmonics:
    """Harmonics in w windows: frequency hz (w,); amplitude of orders 1 to 3 (w, 3); power of the
    noise at each order (w, 3)."""

    hz: Array
    amplitude: Complex
    noise: Array

    @classmethod
    def from_runs(cls, runs: Sequence[Harmonics]) -> Harmonics:
        """Join the windows of all runs."""
        hz, amplitude, noise = (
            np.concatenate([getattr(run, part) for run in runs])
            for part in ("hz", "amplitude", "noise")
        )
        return cls(hz, amplitude, noise)

    def used(self, order: int) -> Flags:
        """Flag the windows (w,) in which a harmonic can be measured."""
        return np.asarray((self.hz > LOWEST_HZ) & (order * self.hz < HIGHEST_HZ))

    def share(self, order: int) -> float:
        """Return a harmonic's share of the answer's amplitude; 0 where all of it may be noise."""
        used = self.used(order)
        if not used.any():
            return 0.0
        power, first = (np.abs(self.amplitude[used][:, [order - 1, 0]]) ** 2).mean(axis=0)
        noise = float(np.median(self.noise[used, order - 1]) / np.log(2.0))
        excess = float(power) - noise
        return float(np.sqrt(excess / first)) if excess > 3.0 * noise / np.sqrt(used.sum()) else 0.0


def harmonics(command: Array, acceleration: Array) -> Harmonics | None:
    """Return orders 1 to 3 of the sweep between the marks; None if the command has no marks.

    command, acceleration (m,): mm/s² along the swept axis, every 1 ms.
    """
    marks = find_marks(command, moving_samples(command))
    if marks is None:
        return None
    part = slice(marks.first + marks.length + marks.answer, marks.second)
    # the slow sway beneath the sweep lies below 1.5 Hz and is no part of its phase
    sos = butter(4, 1.5, "highpass", fs=1.0 / TS, output="sos")
    phase = np.unwrap(np.angle(hilbert(sosfiltfilt(sos, command[part]))))
    a = sosfiltfilt(sos, acceleration[part])
    starts = np.arange(0, len(phase) - WINDOW, HOP)
    taper = np.hanning(WINDOW)
    taper /= taper.sum()

    def order(k: float) -> Complex:
        demodulated = a * np.exp(-1j * k * phase)
        views = np.lib.stride_tricks.sliding_window_view(demodulated, WINDOW)[starts]
        return np.asarray(2.0 * views @ taper)

    hz = (phase[starts + WINDOW] - phase[starts]) / (2.0 * np.pi * WINDOW * TS)
    amplitude = np.column_stack([order(k) for k in (1.0, 2.0, 3.0)])
    between = np.column_stack([order(k) for k in (1.5, 2.5, 3.5)])
    return Harmonics(hz, amplitude, np.abs(between) ** 2)
