"""Where a run was played, told by the run itself: how long it rests before its sweep.

The marks before and after the sweep lie equally far apart in every run, so they align any
recording with any command. The sweep between them begins later by REST for every SPACING of x, up
to a whole round of SLOTS, and a recording of another place than its command's answers the sweep
too early or too late.

How late one run answers beside another is told by the phases alone: whatever the plant does to
them, it does at every place, and

    |Σ e^{j(φ_i − φ_k + ωτ)}|,  φ: phase of the answer to the command

has one narrow peak over τ. How late a run answers by itself is known far less: a plant with two
modes answers twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.signal import fftconvolve, hilbert

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.clock_sync import QUIETEST, band_of, marks_of
from hframe_post.identification.recordings.excitation import LONGEST_REST

SPACING = 10.0  # mm of x
SLOTS = 16
REST = 20  # samples
REACH = LONGEST_REST + 100  # samples by which a sweep's answer may be off
ALONE = 2.5 * REST  # samples of lag that no printer has
APART = 0.6  # of REST, from which an answer is not that of the command,
CLEARLY = 1.5  # if the peak there is so many times the one at its own place


@dataclass(frozen=True, slots=True)
class Answer:
    """To the sweep between the marks. lag: samples by which it is answered later than they are;
    phase (k,): e^{jφ} of what was heard by what was sent, 0 outside the sweep's band."""

    lag: float
    phase: Complex


def rest(x: float) -> int:
    """Samples of rest before the sweep at ``x`` (mm), beyond the usual."""
    return REST * (round(x / SPACING) % SLOTS)


def answer(command: Array, acceleration: Array) -> Answer | None:
    """What tells the place of a run; None without marks.

    command (m,), acceleration (m,): along the swept axis.
    """
    moving = np.flatnonzero(np.abs(command) > QUIETEST * np.abs(command).max(initial=0.0))
    marks = marks_of(command, moving)
    if marks is None:
        return None
    first, last = marks.first + marks.length, marks.second
    u, a = command[first:last], acceleration[max(first - REACH, 0) : last + REACH]
    low, high = band_of(u, (0.05, 0.95))
    return Answer(_lag(u, a, high - low) - min(REACH, first), _phase(u, a, (low, high)))


def _lag(u: Array, a: Array, bandwidth: float) -> float:
    """Where in a (n,) the answer to u (m,) begins, of most energy."""
    envelope = np.abs(fftconvolve(a, hilbert(u).conj()[::-1], "valid"))
    width = max(int(0.5 / bandwidth / TS), 1)  # the peak of a chirp's correlation
    return float(np.argmax(fftconvolve(envelope**2, np.ones(width) / width, "same")))


def _phase(u: Array, a: Array, band_hz: tuple[float, float]) -> Complex:
    n = next_fast_len(len(a), real=True)
    hz = rfftfreq(n, TS)
    cross = rfft(a, n) * rfft(u, n).conj()
    inside = (hz >= band_hz[0]) & (hz <= band_hz[1])
    return np.asarray(np.where(inside, cross / np.maximum(np.abs(cross), 1e-300), 0.0))


def _later(phase: Complex, other: Complex) -> float:
    """Samples by which a run answers later than another; 0 where that is not clear."""
    alike = np.abs(_analytic(phase * other.conj()))
    near = np.concatenate([alike[-REACH:], alike[: REACH + 1]])
    at = int(np.argmax(near)) - REACH
    own = near[REACH - REST // 2 : REACH + REST // 2 + 1].max()
    return float(at) if near[at + REACH] > CLEARLY * own else 0.0


def _analytic(spectrum: Complex) -> Complex:
    """The signal of a spectrum of positive frequencies (k,) alone, (2k − 2,)."""
    real, imaginary = irfft(spectrum), irfft(-1j * spectrum)
    return np.asarray(real + 1j * imaginary)


def check(names: Sequence[str], places: Sequence[float], answers: Sequence[Answer | None]) -> None:
    """Raises IdentificationError where a recording belongs to another place's command.

    The run of the least lag is where it should be, unless that is more than any printer's.
    """
    known = [
        (name, place, own)
        for name, place, own in zip(names, places, answers, strict=True)
        if own is not None
    ]
    if not known:
        return
    first = min((own for _, _, own in known), key=lambda own: abs(own.lag))
    for name, place, own in known:
        if abs(first.lag) > ALONE:
            off, allowed = own.lag, ALONE
        else:
            off, allowed = _beside(own, first), APART * REST
        if abs(off) <= allowed:
            continue
        slot = round((rest(place) + off) / REST) % SLOTS
        own_places = [p for _, p, _ in known if rest(p) == slot * REST]
        which = f"at x = {own_places[0]:g} mm" if own_places else "at another place"
        raise IdentificationError(
            f"{name}: by its own mark this is the recording of the sweep {which}, not of the one "
            f"at x = {place:g} mm. Are the files of two places exchanged?"
        )


def _beside(own: Answer, first: Answer) -> float:
    """How much later than the first; of runs of other sweeps, what each tells by itself."""
    if len(own.phase) != len(first.phase):
        return own.lag - first.lag if abs(own.lag) > ALONE else 0.0
    return _later(own.phase, first.phase)
