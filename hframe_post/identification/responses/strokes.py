"""Frequency responses of strokes, in which both axes move at once and the start is known.

With the spectra of the commands u and of what the sensor shows, y,

    H = P_yu P_uu⁻¹,   noise = P_yy − H P_uu Hᴴ,   var H_ij = noise_i · (P_uu⁻¹)_jj

(Bendat, Piersol, Random Data, 2010, chapter 7). So 1 / (P_uu⁻¹)_jj is the power of a command that
the other one does not explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import signal

from hframe_post.arrays import Array, Complex, X, Y
from hframe_post.identification.recordings.alignment import acceleration
from hframe_post.identification.responses.frequency_response import (
    BANDWIDTH,
    OVERLAP,
    RATE_HZ,
    SEGMENT,
    TINY,
    FrequencyResponse,
)
from hframe_post.identification.responses.measured import (
    MeasurementSettings,
    Run,
    RunGroup,
    RunResponse,
    with_common_delay,
)


def stroke_responses(runs: Sequence[Run], settings: MeasurementSettings) -> dict[int, RunGroup]:
    """Return the responses of the runs of each axis, X or Y. Raises IdentificationError."""
    found: dict[int, list[RunResponse]] = {X: [], Y: []}
    for run in runs:
        responses = _responses(run, settings)
        for axis in run.axes:
            along, across = responses[axis][axis], responses[axis][1 - axis]
            x, y = (at + off for at, off in zip(run.point, settings.offset, strict=True))
            assert run.start is not None
            response = RunResponse(
                x, along, responses[axis][Y], 2.0 * run.start.sd,
                across=across, direction=(1.0 - axis, float(axis)), point=(x, y),
            )  # fmt: skip
            found[axis].append(response)
    return {
        axis: replace(with_common_delay(made), known_start=True)
        for axis, made in found.items()
        if made
    }


def _responses(run: Run, settings: MeasurementSettings) -> dict[int, list[FrequencyResponse]]:
    """Return what a command in each axis that moves does to x and y."""
    u = np.column_stack([acceleration(run.command[:, axis]) for axis in run.axes])
    found = by_axis(u, run.on_command_clock()[:, :2])
    return {
        axis: [one.within(settings.band_hz) for one in each]
        for axis, each in zip(run.axes, found, strict=True)
    }


def by_axis(u: Array, a: Array) -> list[list[FrequencyResponse]]:
    """Return what each of the commands u (n, k) does to x and to y, a (n, 2), mm/s²."""
    segment = min(SEGMENT, len(u) // 2)
    hz, P = _spectra(np.hstack([u, a]), segment)
    k, averages = u.shape[1], BANDWIDTH * len(u) / segment
    P_uu, P_yu, P_yy = P[:, :k, :k], P[:, k:, :k], P[:, k:, k:]
    least = TINY + 1e-12 * np.trace(P_uu, axis1=1, axis2=2).real.max()
    inverse = np.linalg.inv(P_uu + least * np.eye(k))
    H = P_yu @ inverse
    noise = np.einsum("fii->fi", P_yy - H @ P_yu.conj().transpose(0, 2, 1)).real
    found: list[list[FrequencyResponse]] = []
    for j in range(k):
        power = 1.0 / np.maximum(inverse[:, j, j].real, TINY)
        found.append([])
        for i in (X, Y):
            shown = np.abs(H[:, i, j]) ** 2 * power
            coherence = shown / np.maximum(shown + np.maximum(noise[:, i], 0.0), TINY)
            found[-1].append(FrequencyResponse(hz, H[:, i, j], coherence, power, averages))
    return found


def _spectra(values: Array, segment: int) -> tuple[Array, Complex]:
    """Return frequencies (f,) and cross spectra (f, k, k), [i, j]: conj(j)·i, of values (n, k)."""
    padded = np.pad(values, ((segment, segment), (0, 0))).T
    options = {
        "fs": RATE_HZ, "window": "hann", "nperseg": segment,
        "noverlap": int(OVERLAP * segment), "detrend": False,
    }  # fmt: skip
    hz, spectra = signal.csd(padded[None, :, :], padded[:, None, :], **options)
    kept = slice(2, None, 2)  # those between add nothing, with a Hann window
    return hz[kept], np.moveaxis(spectra, -1, 0)[kept]
