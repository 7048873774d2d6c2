"""How far an axis' impulse response has changed, from a short run: the profile is the prior.

Of q, the deviation after a pulse of acceleration, a later one is expected to be

    q'(t) = s·q(t/s) + Δ(t),    Δ ~ N(0, K),
    K_jk = σ_j σ_k ALIKE^|j−k| cos ω₀(j − k),    σ = SIZE·(1 + ω₀|t|)·envelope of q

First all frequencies change alike, as belts slacken: s is what alone explains most of the run. The
rest is a share of q, near its main resonance ω₀: a mode whose frequency or damping changes by ε
changes q by ε ω t of its size, hence the factor. With the sensor's gain g and delay τ the run shows
g e^{−2πifτ} G'(f). Δ, g and τ are found by least squares with that prior, by Gauss-Newton in g and
τ. What remains is the noise. Gain at rest stays exact, since q' acts on acceleration.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy import linalg
from scipy.signal import hilbert

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.checking.evidence import (
    EXCITED,
    FARTHEST_HZ,
    LEAST_EXPLAINED,
    LEAST_FREQUENCIES,
    NOTICED,
    STEPS_DAMPING,
    STEPS_HZ,
    UNMOVED,
    Drift,
    Peak,
    Recorded,
    explained,
    left_unseen,
    scaled,
    scaling,
)
from hframe_post.identification.responses.frequency_response import NOISE_FLOOR, FrequencyResponse
from hframe_post.model.impulse_response import ImpulseResponse

GAIN = 0.05  # standard deviation of log g
SIZE, ALIKE = 0.02, 0.9
LEAST = 0.01  # of the largest envelope of q, that counts as its envelope
LEAST_CHANGE = NOTICED * STEPS_DAMPING  # share of the response
WIDEST, STEP = 0.2, 0.002  # of log s: where it is sought
PEAK_HZ = (15.0, 120.0)  # in which the main resonance is
LOWEST_HZ = 6.0  # below it, table and frame move as much as the axis
NEAR = 0.1  # of the main resonance, in which it is sought again
FINE_HZ = 0.05  # between frequencies from which others are interpolated
ROUNDS, DRAWS = 6, 40


def highest_hz(G: ImpulseResponse) -> float:
    """Return the frequency above which the nozzle moves less than its command, up to PEAK_HZ."""
    hz = np.arange(FINE_HZ, PEAK_HZ[1], FINE_HZ)
    return float(hz[np.abs(_response(G, hz)) >= 1.0].max(initial=0.0))


def drift(G: ImpulseResponse, recorded: Recorded) -> Drift:
    """Return how an impulse response changed.

    Raises IdentificationError if the recording is not of its printer.
    """
    main, height = _main(G)
    part = recorded.response.within((LOWEST_HZ, PEAK_HZ[1]))
    part = part.where(part.power > EXCITED * np.median(part.power))
    if len(part.hz) < LEAST_FREQUENCIES:
        raise IdentificationError("the motion is too short to show the resonances")
    found = _Fit(G, part)
    new = found.response
    _check_same_printer(found, main)
    low, high = (main / found.stretch * (1.0 + side) for side in (-NEAR, NEAR))
    near = np.arange(low, high, FINE_HZ)
    f, h = _peaks(near, np.abs(found.drawn(near)))
    sd = np.hypot(f[1:].std(), STEPS_HZ * f[0]), np.hypot(h[1:].std(), STEPS_DAMPING * h[0])
    peak = Peak((main, float(f[0])), (height, float(h[0])), (float(sd[0]), float(sd[1])))
    band = float(part.hz[0]), float(part.hz[-1])
    old, now = (left_unseen(partial(_response, one), recorded.unseen, band) for one in (G, new))
    seen = found.seen or peak.certain
    return Drift(new, seen, (old, now), NOTICED * peak.sd[0] / peak.hz[1], peak=peak)


def _response(G: ImpulseResponse, hz: Array) -> Complex:
    return np.asarray(G.response(2.0 * np.pi * TS * hz))


def _main(G: ImpulseResponse) -> tuple[float, float]:
    hz = np.arange(*PEAK_HZ, FINE_HZ)
    f, h = _peaks(hz, np.abs(_response(G, hz))[:, None])
    return float(f[0]), float(h[0])


def _peaks(hz: Array, size: Array) -> tuple[Array, Array]:
    """Return where each column of size (k, n) is largest, Hz, and how large, by parabolas."""
    at, n = np.clip(np.argmax(size, axis=0), 1, len(hz) - 2), np.arange(size.shape[1])
    before, here, after = (size[at + step, n] for step in (-1, 0, 1))
    curve = np.minimum(before - 2.0 * here + after, -np.finfo(float).tiny)
    shift = np.clip((before - after) / (2.0 * curve), -1.0, 1.0)
    return hz[at] + FINE_HZ * shift, here - (before - after) * shift / 4.0


def _check_same_printer(found: _Fit, main: float) -> None:
    """Raise IdentificationError if neither the old nor the stretched response explains the run."""
    share = explained(found.part)
    if share(found.at(1.0)) > UNMOVED:
        return
    if abs(np.log(found.stretch)) > FARTHEST_HZ:
        raise IdentificationError(
            f"the main resonance, at {main:.1f} Hz in the profile, would move farther than "
            f"printers drift ({100 * FARTHEST_HZ:.0f} %). Is it another printer, or was a belt, "
            "the head or the bed changed? Identify again"
        )
    if share(found.at(found.stretch)) < LEAST_EXPLAINED:
        raise IdentificationError(
            "the profile's response, moved as printers drift, explains "
            f"{100 * max(share(found.at(found.stretch)), 0.0):.0f} % of what it could of this "
            "recording: it is of another printer, or of one that was rebuilt. Identify again"
        )


class _Fit:
    """The response that a run shows, with its posterior.

    stretch, change (m,): s and Δ. seen: whether they explain more of the run than as many numbers
    explain of noise (Akaike), and change the response by more than motor steps do.
    """

    def __init__(self, G: ImpulseResponse, part: FrequencyResponse) -> None:
        self.G, self.part = G, part
        self._t = np.arange(len(G.deviation)) - G.lead
        self._fine = np.arange(0.0, part.hz[-1] * np.exp(WIDEST + STEP), FINE_HZ)
        self._at_fine = _response(G, self._fine)
        nearest = scaling(part)
        tried = np.exp(np.arange(-WIDEST, WIDEST + STEP / 2.0, STEP))
        fits = [nearest(self.at(s)) for s in tried.tolist()]
        best = int(np.argmin([fit.left for fit in fits]))
        self.stretch, self.change = float(tried[best]), np.zeros(len(self._t))
        self._solve(fits[best].gain, fits[best].late)
        self.seen = self._gained() > 2.0 * self._counted and self._apart() > LEAST_CHANGE

    def _gained(self) -> float:
        """Return by how much the run's χ² falls from the old response to the new one."""
        judged = replace(self.part, power=self._weight**2)
        nearest = scaling(judged)
        before, now = (nearest(H).left ** 2 for H in (self.at(1.0), self._now))
        return (before - now) * float(judged.power @ np.abs(judged.H) ** 2)

    def _apart(self) -> float:
        """Return the share of the old response that the new one leaves."""
        return scaled(self._now, replace(self.part, H=self.at(1.0))).left

    def at(self, stretch: float, hz: Array | None = None) -> Complex:
        """Return the old response at stretched frequencies, by default those of the run."""
        hz = self.part.hz if hz is None else hz
        return np.asarray(np.interp(stretch * hz, self._fine, self._at_fine))

    def _by_change(self, hz: Array) -> Complex:
        """Return the matrix (k, m) by which Δ changes G."""
        turn = np.exp(-2j * np.pi * TS * np.outer(hz, self._t))
        return np.asarray(-((2.0 * np.sin(np.pi * TS * hz[:, None])) ** 2) * turn)

    def _prior(self) -> Array:
        """Return K⁻¹ (m, m)."""
        m = len(self._t)
        envelope = np.abs(hilbert(np.pad(self.G.deviation, m)))[m:-m]
        envelope = np.maximum(envelope, LEAST * envelope.max())
        omega = 2.0 * np.pi * TS * _main(self.G)[0]
        sd = SIZE * envelope * (1.0 + omega * np.abs(self._t))
        apart = np.abs(self._t[:, None] - self._t)
        alike = ALIKE**apart * np.cos(omega * apart)
        return np.asarray(linalg.inv(alike) / np.outer(sd, sd))

    def _solve(self, gain: float, late: float) -> None:
        hz, H, power = self.part.hz, self.part.H, self.part.power
        columns, prior, log_g = self._by_change(hz), self._prior(), float(np.log(abs(gain)))
        for _ in range(ROUNDS):
            G = self.at(self.stretch) + columns @ self.change
            sensor = np.sign(gain) * np.exp(log_g - 2j * np.pi * hz * late)
            noise = (power * np.abs(H - sensor * G) ** 2).mean() / power
            weight = np.sqrt(2.0 / (noise + (NOISE_FLOOR * np.abs(H)) ** 2))
            J = np.column_stack([G, -2j * np.pi * hz * TS * G, columns])
            J = J * (sensor * weight)[:, None]
            J = np.concatenate([J.real, J.imag])
            missed = (H - sensor * G) * weight
            known = np.concatenate([[log_g, 0.0], self.change])
            data = J.T @ J
            A = data.copy()
            A[0, 0] += 1.0 / GAIN**2
            A[2:, 2:] += prior
            b = J.T @ (np.concatenate([missed.real, missed.imag]) + J @ known)
            solution = linalg.solve(A, b, assume_a="pos")
            log_g, late, self.change = solution[0], late + TS * solution[1], solution[2:]
        self._A, self._weight = A, weight
        self._counted = float(np.trace(linalg.solve(A, data, assume_a="pos")))
        self._now = self.at(self.stretch) + columns @ self.change

    @property
    def response(self) -> ImpulseResponse:
        """Return the response as it is now, as long as the old one."""
        stretched = self.G.stretched(self.stretch)
        first = stretched.lead - self.G.lead
        padded = np.pad(stretched.deviation, len(self._t))[len(self._t) + first :]
        return replace(self.G, deviation=padded[: len(self._t)] + self.change)

    def drawn(self, hz: Array) -> Complex:
        """Return G (k, 1 + DRAWS) at Hz: as found, then drawn from the posterior."""
        L = np.asarray(linalg.cholesky(self._A, lower=True))
        random = np.random.default_rng(0).normal(size=(len(L), DRAWS))
        off = linalg.solve_triangular(L.T, random)
        columns = self._by_change(hz)
        found = self.at(self.stretch, hz) + columns @ self.change
        return np.column_stack([found, found[:, None] + columns @ off[2:]])
