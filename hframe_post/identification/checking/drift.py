"""How far an axis' impulse response has changed, from a short run: the profile is the prior.

Of q, the deviation after a pulse of acceleration, a later one is expected to be

    q'(t) = s·q(t/s) + Δ(t),    Δ(t) = Re Σ_b A_b(t)·q_b(t),    u = ω_b |t|,
    A_b = a + b·u + Σ_j c_j (1 + u) Λ_j(log(1 + u))

First all frequencies change alike, as belts slacken: s is what alone explains most of the run. Then
each mode changes by itself (``modal``), which is most of what a printer does. What that leaves is
Δ: q_b, the part of q in a band about ω_b, changes as a complex signal. If the share, the
damping or the frequency of a mode changes by ε, its A is ε, −ε ζ u or i ε u, so a and b, complex,
are what is expected first. Hat functions Λ_j, one a step of log(1 + u), follow a mode that turns by
more, and what no mode describes. With the sensor's gain g and delay τ the run shows
g e^{−2πifτ} G'(f). All but s is found by least squares with that prior, by Gauss-Newton in g and
τ. What remains is the noise. Gain at rest stays exact, since q' acts on acceleration. Δ is zero
unless it also explains more of what was not fitted.

A profile with poles and zeros is turned into its impulse response first. Delays and racking stay: a
short run at one place does not show them. An axis changes only if its new model is better on what
was not fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg

from hframe_post.arrays import TS, Array, Complex, X
from hframe_post.errors import IdentificationError
from hframe_post.identification.checking.modal import drifted
from hframe_post.identification.checking.report import NOTICED, Drift, Peak
from hframe_post.identification.checking.run import (
    Recorded,
    at_hz,
    explained,
    left_unseen,
    of_run,
    scaling,
)  # fmt: skip
from hframe_post.identification.responses.frequency_response import (
    NOISE_FLOOR,
    FrequencyResponse,
    lowest,
)
from hframe_post.identification.responses.measured import Run
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.stream.running import one_blas_thread

SETTLED = 1e-3  # of its largest deviation, below which a response has ended
EXCITED = 0.1  # of the median power of the command
LEAST_FREQUENCIES = 50
LEAST_EXPLAINED = 0.3  # of what a linear model can explain, by the stretched response
UNMOVED = 0.5  # the same by the old response, from which on it is that of this printer
FARTHEST = 0.1  # change of frequencies, relative
STEPS_HZ, STEPS = 5e-4, 0.01  # relative, by which motor steps shift and change every run
BETTER = 0.7  # times what modes leave of what was not fitted, from which on Δ is believed
LEAST_CHANGE = NOTICED * STEPS  # share of the response
GAIN = 0.05  # standard deviation of log g
BANDS_HZ, BAND = (12.0, 130.0), 0.25  # between the centres of bands: of log ω
CHANGED, SHAPED = 0.03, 0.01  # standard deviations of a and b, and of c
WIDEST, STEP = 0.2, 0.002  # of log s: where it is sought
PEAK_HZ = (15.0, 120.0)  # in which the main resonance is
LOWEST_HZ = 6.0  # below it, table and frame move as much as the axis
NEAR = 0.1  # of the main resonance, in which it is sought again
FINE_HZ = 0.05  # between frequencies from which others are interpolated
ROUNDS, DRAWS = 6, 40


@one_blas_thread()
def drifts(plant: Plant, runs: Sequence[Run]) -> dict[str, Drift]:
    """Return what drifted, by Gxx and Gyy, from at most one run of each axis.

    runs: with recordings along the printer's axes. Raises IdentificationError.
    """
    found = {}
    for run in runs:
        name, G = ("Gxx", plant.Gxx) if run.axis == X else ("Gyy", plant.Gyy)
        try:
            found[name] = drift(G, of_run(run))
        except IdentificationError as error:
            raise IdentificationError(f"{run.name}: {error}") from None
    return found


def drift(G: ImpulseResponse, recorded: Recorded) -> Drift:
    """Return how an axis' response changed.

    Raises IdentificationError if the recording is not of its printer.
    """
    if not G.deviation.any():
        raise IdentificationError("the profile's model does not ring, so there is nothing to check")
    part = recorded.response.within((LOWEST_HZ, PEAK_HZ[1]))
    part = part.where(part.power > EXCITED * np.median(part.power))
    if len(part.hz) < LEAST_FREQUENCIES:
        raise IdentificationError("the motion is too short to show the resonances")
    fine = np.arange(*PEAK_HZ, FINE_HZ)
    main, height = _main(G, fine)
    found = _DriftFit(G, part)
    _check_same_printer(found, main)
    band = (float(part.hz[0]), float(part.hz[-1]))
    by_modes, by_change, _ = left_unseen(found.modal.G, found.response, recorded.unseen, band)
    if by_change > BETTER * by_modes:
        found.drop_change()
    near = np.arange(1.0 - NEAR, 1.0 + NEAR, FINE_HZ / main) * main / found.stretch
    f, h = _peaks(near, np.abs(found.drawn(near)))
    sd = [float(np.hypot(one[1:].std(), by * one[0])) for one, by in ((f, STEPS_HZ), (h, STEPS))]
    peak = Peak((main, float(f[0])), (height, float(h[0])), (sd[0], sd[1]))
    new = found.response
    before, now, apart = left_unseen(G, new, recorded.unseen, band)
    seen = (found.seen or peak.certain) and apart > STEPS
    return Drift(new, seen, (before, now), peak, found.modal.modes)


def _main(G: ImpulseResponse, hz: Array) -> tuple[float, float]:
    """Return frequency and height of the peak that moves a print most: of G − 1 over f²."""
    H = at_hz(G, hz)
    moving = hz[np.argmax(np.abs(H - 1.0) / hz**2)]
    around = np.abs(hz / moving - 1.0) < NEAR
    f, h = _peaks(hz[around], np.abs(H[around])[:, None])
    return float(f[0]), float(h[0])


def _peaks(hz: Array, size: Array) -> tuple[Array, Array]:
    """Return where each column of size (k, n) is largest, Hz, and how large, by parabolas."""
    at, n = np.clip(np.argmax(size, axis=0), 1, len(hz) - 2), np.arange(size.shape[1])
    before, here, after = (size[at + step, n] for step in (-1, 0, 1))
    curve = np.minimum(before - 2.0 * here + after, -np.finfo(float).tiny)
    shift = np.clip((before - after) / (2.0 * curve), -1.0, 1.0)
    return hz[at] + (hz[1] - hz[0]) * shift, here - (before - after) * shift / 4.0


def _check_same_printer(found: _DriftFit, main: float) -> None:
    """Raise IdentificationError if neither the old nor the stretched response explains the run."""
    share = explained(found.part)
    if share(found.at(1.0)) > UNMOVED:
        return
    most = share(found.at(found.stretch))
    if abs(np.log(found.stretch)) > FARTHEST or most < LEAST_EXPLAINED:
        raise IdentificationError(
            "the recording is of another printer, or a belt, the head or the bed was changed: even "
            f"with the main resonance moved from {main:.1f} to {main / found.stretch:.1f} Hz, "
            f"the profile explains {100 * max(most, 0.0):.0f} % "
            "of what it could. Identify again"
        )


class _DriftFit:
    """The response that a run shows, with its posterior.

    stretch: s. modal: the response without Δ. seen: whether they explain more of the run than as
    many numbers explain of noise (Akaike), and change the response by more than motor steps do.
    """

    def __init__(self, G: ImpulseResponse, part: FrequencyResponse) -> None:
        self.G, self.part = G, part
        self._t = np.arange(len(G.deviation)) - G.lead
        self._fine = np.arange(0.0, part.hz[-1] * np.exp(WIDEST + STEP), FINE_HZ)
        self._at_fine = at_hz(G, self._fine)
        nearest = scaling(part)
        tried = np.exp(np.arange(-WIDEST, WIDEST + STEP / 2.0, STEP))
        fits = [nearest(self.at(s)) for s in tried.tolist()]
        best = int(np.argmin([left for *_, left in fits]))
        self.stretch = float(np.exp(lowest(np.log(tried), [left**2 for *_, left in fits])))
        self.modal = drifted(G, self.stretch, part, fits[best][1])
        self._by_modes = at_hz(self.modal.G, part.hz)
        self._expected = self._changes()
        self._solve(*fits[best][:2])
        self.seen = self._is_seen()

    def _is_seen(self) -> bool:
        # by how much χ² falls, and the share of the old response that the new one leaves
        judged = replace(self.part, power=self._weight**2)
        before, now = (scaling(judged)(H)[2] ** 2 for H in (self.at(1.0), self._now))
        gained = (before - now) * float(judged.power @ np.abs(judged.H) ** 2)
        apart = scaling(replace(self.part, H=self.at(1.0)))(self._now)[2]
        return bool(gained > 2.0 * self._counted and apart > LEAST_CHANGE)

    def drop_change(self) -> None:
        """Make Δ zero."""
        self._change = np.zeros(self._expected.shape[1])
        self._now = self._by_modes
        self.seen = self._is_seen()

    def at(self, stretch: float) -> Complex:
        """Return the old response at the frequencies of the run, stretched."""
        return np.asarray(np.interp(stretch * self.part.hz, self._fine, self._at_fine))

    def _changes(self) -> Array:
        """Return what Δ is made of (m, p), each expected as often as its standard deviation."""
        q, m = self.G.deviation, len(self._t)
        hz = np.fft.fftfreq(3 * m + 500, TS)  # far longer, since bands ring before and after q
        centres = np.arange(np.log(BANDS_HZ[0]), np.log(BANDS_HZ[1]), BAND)
        away = np.log(np.clip(hz, *BANDS_HZ)) - centres[:, None]
        share = np.exp(-((away / BAND) ** 2) / 2.0)
        spectrum = 2.0 * (hz > 0.0) * np.fft.fft(q, len(hz)) / share.sum(axis=0)
        columns = []
        for one, centre in zip(share, centres.tolist(), strict=True):
            part = np.fft.ifft(spectrum * one)[:m]
            u = 2.0 * np.pi * TS * np.exp(centre) * np.abs(self._t)
            v = np.log1p(u)
            hats = np.maximum(1.0 - np.abs(v - np.arange(np.ceil(v.max()) + 1.0)[:, None]), 0.0)
            slow = np.vstack([CHANGED * np.ones(m), CHANGED * u, SHAPED * (1.0 + u) * hats])
            columns += [slow * part.real, slow * part.imag]
        return np.vstack(columns).T

    def _by_change(self, hz: Array) -> Complex:
        """Return the matrix (k, p) by which what Δ is made of changes G."""
        turn = np.exp(-2j * np.pi * TS * np.outer(hz, self._t))
        by_acceleration = (2.0 * np.sin(np.pi * TS * hz[:, None])) ** 2
        return np.asarray(-by_acceleration * (turn @ self._expected))

    def _solve(self, gain: float, late: float) -> None:
        hz, H, power = self.part.hz, self.part.H, self.part.power
        columns, log_g = self._by_change(hz), float(np.log(abs(gain)))
        prior = np.concatenate([[1.0 / GAIN**2, 0.0], np.ones(columns.shape[1])])
        change = np.zeros(columns.shape[1])
        for _ in range(ROUNDS):
            G = self._by_modes + columns @ change
            sensor = np.sign(gain) * np.exp(log_g - 2j * np.pi * hz * late)
            noise = (power * np.abs(H - sensor * G) ** 2).mean() / power
            weight = np.sqrt(2.0 / (noise + (NOISE_FLOOR * np.abs(H)) ** 2))
            J = np.column_stack([G, -2j * np.pi * hz * TS * G, columns])
            J = J * (sensor * weight)[:, None]
            J = np.concatenate([J.real, J.imag])
            missed = (H - sensor * G) * weight
            known = np.concatenate([[log_g, 0.0], change])
            data = J.T @ J
            A = data + np.diag(prior)
            b = J.T @ (np.concatenate([missed.real, missed.imag]) + J @ known)
            solution = linalg.solve(A, b, assume_a="pos")
            log_g, late, change = solution[0], late + TS * solution[1], solution[2:]
        self._A, self._weight, self._change = A, weight, change
        self._counted = float(np.trace(linalg.solve(A, data, assume_a="pos")))
        self._now = self._by_modes + columns @ change

    @property
    def response(self) -> ImpulseResponse:
        """Return the response as it is now, as long as the old one."""
        changed = self.modal.G.deviation + self._expected @ self._change
        return replace(self.modal.G, deviation=changed)

    def drawn(self, hz: Array) -> Complex:
        """Return G (k, 1 + DRAWS) at Hz: as found, then drawn from the posterior."""
        L = np.asarray(linalg.cholesky(self._A, lower=True))
        random = np.random.default_rng(0).normal(size=(len(L), DRAWS))
        off = np.asarray(linalg.solve_triangular(L.T, random))[2:]
        changes = np.column_stack([np.zeros(len(off)), off]) + self._change[:, None]
        return np.asarray(at_hz(self.modal.G, hz)[:, None] + self._by_change(hz) @ changes)
