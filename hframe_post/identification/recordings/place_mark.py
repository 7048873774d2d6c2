"""The place of a run, encoded in the run itself: how long it rests before its sweep.

The marks before and after the sweep are equally far apart in every run, so any recording can be
aligned with any command. The sweep between them begins later by REST for every SPACING of x, up
to a whole round of SLOTS. A recording that was exchanged with another place's therefore answers
the sweep too early or too late.

The delay between two runs' answers follows from their phases alone, since the plant's effect on
the phase is the same at every place:

    |Σ e^{j(φ_i − φ_k + ωτ)}|,  φ: phase of the answer relative to the command

has one narrow peak over τ. The delay of a single run is known far less: a plant with two modes
answers twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.signal import fftconvolve, hilbert

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.clock_sync import (
    energy_band,
    find_marks,
    moving_samples,
)
from hframe_post.identification.recordings.excitation import LONGEST_REST

SPACING = 10.0  # mm of x
SLOTS = 16
REST = 20  # samples
REACH = LONGEST_REST + 100  # samples by which a sweep's answer may be off
LARGEST_LAG = 2.5 * REST  # samples; no printer lags more
TOLERANCE = 0.6 * REST  # samples by which a run's answer may be off


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to the sweep between the marks.

    lag: samples by which it comes later than the answers to the marks. phase (k,): e^{jφ} of
    the answer relative to the command, 0 outside the sweep's band.
    """

    lag: float
    phase: Complex


def rest(x: float) -> int:
    """Return the samples of extra rest before the sweep at ``x`` (mm)."""
    return REST * (round(x / SPACING) % SLOTS)


def answer(command: Array, acceleration: Array) -> Answer | None:
    """Return when and how a recording answers the sweep; None if the command has no marks.

    command (m,), acceleration (m,): along the swept axis.
    """
    marks = find_marks(command, moving_samples(command))
    if marks is None:
        return None
    first, last = marks.first + marks.length, marks.second
    u, a = command[first:last], acceleration[max(first - REACH, 0) : last + REACH]
    low, high = energy_band(u, (0.05, 0.95))
    return Answer(_lag(u, a, high - low) - min(REACH, first), _phase(u, a, (low, high)))


def _lag(u: Array, a: Array, bandwidth: float) -> float:
    """Return the sample at which the answer of most energy to u (m,) begins in a (n,)."""
    envelope = np.abs(fftconvolve(a, hilbert(u).conj()[::-1], "valid"))
    width = max(int(0.5 / bandwidth / TS), 1)  # the peak of a chirp's correlation
    return float(np.argmax(fftconvolve(envelope**2, np.ones(width) / width, "same")))


def _phase(u: Array, a: Array, band_hz: tuple[float, float]) -> Complex:
    n = next_fast_len(len(a), real=True)
    hz = rfftfreq(n, TS)
    cross = rfft(a, n) * rfft(u, n).conj()
    inside = (hz >= band_hz[0]) & (hz <= band_hz[1])
    return np.asarray(np.where(inside, cross / np.maximum(np.abs(cross), 1e-300), 0.0))


def _delay_between(answer: Answer, reference: Answer) -> float:
    """Return the samples by which an answer is later than another; 0 where that is not clear."""
    if len(answer.phase) != len(reference.phase):  # runs of different sweeps
        return answer.lag - reference.lag if abs(answer.lag) > LARGEST_LAG else 0.0
    spectrum = answer.phase * reference.phase.conj()
    correlation = np.abs(irfft(spectrum) + 1j * irfft(-1j * spectrum))
    near = np.concatenate([correlation[-REACH:], correlation[: REACH + 1]])
    peak = int(np.argmax(near))
    at_zero = near[REACH - REST // 2 : REACH + REST // 2 + 1].max()
    return float(peak - REACH) if near[peak] > 1.5 * at_zero else 0.0


def check(names: Sequence[str], places: Sequence[float], answers: Sequence[Answer | None]) -> None:
    """Raise IdentificationError if a recording belongs to the command of another place.

    The run of the least lag is taken to be right, unless its lag is more than any printer's.
    """
    known = [
        (name, place, found)
        for name, place, found in zip(names, places, answers, strict=True)
        if found is not None
    ]
    if not known:
        return
    reference = min((found for _, _, found in known), key=lambda found: abs(found.lag))
    for name, place, found in known:
        if abs(reference.lag) > LARGEST_LAG:
            off, allowed = found.lag, LARGEST_LAG
        else:
            off, allowed = _delay_between(found, reference), TOLERANCE
        if abs(off) <= allowed:
            continue
        slot = round((rest(place) + off) / REST) % SLOTS
        matching = [p for _, p, _ in known if rest(p) == slot * REST]
        which = f"at x = {matching[0]:g} mm" if matching else "at another place"
        raise IdentificationError(
            f"{name} is the recording of the sweep {which}, but was given with the command of "
            f"x = {place:g} mm. Check whether the files of two places are exchanged"
        )
