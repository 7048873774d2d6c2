"""Harmonics of a sweep in what a sensor heard.

A linear printer answers a sine by a sine. The sweep's phase φ(t) is known, so the answer is taken
apart into A_k(t) e^{jkφ} in short windows. What lies at half-way orders, k + ½, is noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, hilbert, sosfiltfilt

from hframe_post.arrays import TS, Array, Complex, Flags
from hframe_post.identification.recordings.clock_sync import QUIETEST, marks_of

WINDOW, HOP = 1000, 500  # samples
LOWEST_HZ = 5.0  # of the sweep, from which orders are apart
SWAY_HZ = 1.5  # below it lies the sway, which is no part of the sweep
HIGHEST_HZ = 240.0  # to which recordings are flat
CLEAR = 3.0  # times the noise, from which a harmonic is one


@dataclass(frozen=True, slots=True)
class Harmonics:
    """Of one run, a row a window: hz (w,), amplitude by order and power of noise (w, 3)."""

    hz: Array
    amplitude: Complex
    noise: Array

    @classmethod
    def of(cls, runs: Sequence[Harmonics]) -> Harmonics:
        """The windows of all runs."""
        hz, amplitude, noise = (
            np.concatenate([getattr(run, part) for run in runs])
            for part in ("hz", "amplitude", "noise")
        )
        return cls(hz, amplitude, noise)

    def used(self, order: int) -> Flags:
        """Windows (w,) in which a harmonic can be told."""
        return np.asarray((self.hz > LOWEST_HZ) & (order * self.hz < HIGHEST_HZ))

    def share(self, order: int) -> float:
        """Of the answer's amplitude that a harmonic is; 0 where noise may be all of it."""
        used = self.used(order)
        if not used.any():
            return 0.0
        power, first = (np.abs(self.amplitude[used][:, [order - 1, 0]]) ** 2).mean(axis=0)
        quiet = float(np.median(self.noise[used, order - 1]) / np.log(2.0))
        heard = float(power) - quiet
        return float(np.sqrt(heard / first)) if heard > CLEAR * quiet / np.sqrt(used.sum()) else 0.0


def harmonics(command: Array, acceleration: Array) -> Harmonics | None:
    """Orders 1 to 3 of the sweep between the marks; None without marks.

    command, acceleration (m,): mm/s² along the swept axis, every 1 ms.
    """
    moving = np.flatnonzero(np.abs(command) > QUIETEST * np.abs(command).max(initial=0.0))
    marks = marks_of(command, moving)
    if marks is None:
        return None
    part = slice(marks.first + marks.length + marks.answer, marks.second)
    sos = butter(4, SWAY_HZ, "highpass", fs=1.0 / TS, output="sos")
    phase = np.unwrap(np.angle(hilbert(sosfiltfilt(sos, command[part]))))
    a = sosfiltfilt(sos, acceleration[part])
    starts = np.arange(0, len(phase) - WINDOW, HOP)
    taper = np.hanning(WINDOW)
    taper /= taper.sum()

    def order(k: float) -> Complex:
        turned = a * np.exp(-1j * k * phase)
        views = np.lib.stride_tricks.sliding_window_view(turned, WINDOW)[starts]
        return np.asarray(2.0 * views @ taper)

    hz = (phase[starts + WINDOW] - phase[starts]) / (2.0 * np.pi * WINDOW * TS)
    amplitude = np.column_stack([order(k) for k in (1.0, 2.0, 3.0)])
    beside = np.column_stack([order(k) for k in (1.5, 2.5, 3.5)])
    return Harmonics(hz, amplitude, np.abs(beside) ** 2)
