"""What a short run shows of a model, whatever that model is made of, and what follows from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.responses.frequency_response import (
    FrequencyResponse,
    delays,
    whole_record,
)
from hframe_post.model.impulse_response import Linear

LATE = np.arange(-15e-3, 15e-3, 5e-5)  # s by which a recording may begin late
LEAST_EXPLAINED = 0.3  # of what a linear model can explain, by the moved model
UNMOVED = 0.5  # the same by the old model, from which on it is that of this printer
# farthest change: of frequency and damping ratio, relative, and of a mode's contribution
FARTHEST_HZ, FARTHEST_DAMPING, FARTHEST_SHARE = 0.1, 2.0, 0.3
SMOOTHED_HZ = 0.5  # over which a printer's response hardly changes, even at a resonance
EXCITED = 0.1  # of the median power of the command
LEAST_FREQUENCIES = 50
NOTICED = 2.0  # standard deviations
STEPS_HZ, STEPS_DAMPING = 5e-4, 0.01  # relative, by which motor steps shift a mode in every run


@dataclass(frozen=True, slots=True)
class Moved:
    """A mode before and now. sd: of the frequency and the damping ratio, relative."""

    hz: tuple[float, float]
    damping: tuple[float, float]
    share: tuple[float, float]
    sd: tuple[float, float]

    @property
    def certain(self) -> bool:
        """Return whether the mode moved by more than its uncertainty."""
        changes = (now / before - 1.0 for before, now in (self.hz, self.damping))
        return any(abs(d) > NOTICED * sd for d, sd in zip(changes, self.sd, strict=True))

    @property
    def too_far(self) -> bool:
        ratio = self.damping[1] / self.damping[0]
        return (
            abs(self.hz[1] / self.hz[0] - 1.0) > FARTHEST_HZ
            or not 1.0 / FARTHEST_DAMPING <= ratio <= FARTHEST_DAMPING
            or abs(self.share[1] - self.share[0]) > FARTHEST_SHARE
        )

    def as_text(self) -> str:
        (f0, f1), (z0, z1) = self.hz, self.damping
        return (
            f"{f0:.2f} → {f1:.2f} Hz ({100 * (f1 / f0 - 1.0):+.1f} ± {200 * self.sd[0]:.1f} %), "
            f"damping {z0:.3f} → {z1:.3f} (± {2.0 * self.sd[1] * z1:.3f})"
        )

    def as_json(self) -> dict[str, Any]:
        return {"hz": list(self.hz), "damping": list(self.damping), "sd": list(self.sd)}


@dataclass(frozen=True, slots=True)
class Peak:
    """The main resonance before and now: Hz, and |G| there. sd: of both now."""

    hz: tuple[float, float]
    height: tuple[float, float]
    sd: tuple[float, float]

    @property
    def certain(self) -> bool:
        """Return whether the resonance moved by more than its uncertainty."""
        return abs(self.hz[1] - self.hz[0]) > NOTICED * self.sd[0]

    def as_text(self) -> str:
        (f0, f1), (h0, h1) = self.hz, self.height
        hz, height = (NOTICED * sd for sd in self.sd)
        how = f"moved from {f0:.1f} to {f1:.1f} Hz" if self.certain else f"stays at {f0:.1f} Hz"
        peak = f"its peak {h0:.1f} → {h1:.1f} (±{height:.1f})"
        return f"the main resonance {how} (±{max(hz, 0.1):.1f}), {peak}"

    def as_json(self) -> dict[str, Any]:
        rounded = {
            name: [round(one, 3) for one in getattr(self, name)] for name in ("hz", "height")
        }
        return {**rounded, "sd": [round(one, 4) for one in self.sd]}


@dataclass(frozen=True, slots=True)
class Recorded:
    """A motion along an axis: the response to fit, and command and answer (n,), mm/s², to judge."""

    response: FrequencyResponse
    unseen: tuple[Array, Array]


@dataclass(frozen=True, slots=True)
class Drift:
    """A response as it is now.

    seen: whether the fitted motion shows a change. left: share of the unseen answer that the old
    and the new model leave. uncertainty: of the new one, as ``plant.uncertainty``. modes: those
    that ring, of a transfer function. peak: the main resonance of an impulse response.
    """

    G: Linear
    seen: bool
    left: tuple[float, float]
    uncertainty: float
    modes: Sequence[Moved] = ()
    peak: Peak | None = None

    @property
    def changes(self) -> list[Moved | Peak]:
        """Return what is shown of the change."""
        return [*self.modes, *([self.peak] if self.peak else [])]

    @property
    def certain(self) -> bool:
        """Return whether the new model is also better where it was not fitted."""
        return self.seen and self.left[1] < self.left[0]


@dataclass(frozen=True, slots=True)
class Scaled:
    """A modelled response as a sensor shows it. left: share of the recording that it leaves."""

    gain: float
    late: float
    left: float


def scaled(H: Complex, part: FrequencyResponse) -> Scaled:
    """Return the sensor's gain and delay with which H (k,) is nearest to a response."""
    return scaling(part)(H)


def scaling(part: FrequencyResponse) -> Callable[[Complex], Scaled]:
    """Return ``scaled`` for many responses."""
    turned = np.exp(2j * np.pi * np.outer(LATE, part.hz)) * (part.power * part.H)
    size = float(part.power @ np.abs(part.H) ** 2)

    def nearest(H: Complex) -> Scaled:
        cross = (turned @ H.conj()).real
        k = int(np.argmax(cross))
        own = float(part.power @ np.abs(H) ** 2)
        left = float(np.sqrt(max(1.0 - cross[k] ** 2 / (own * size), 0.0)))
        return Scaled(float(cross[k] / own), float(LATE[k]), left)

    return nearest


def left_unseen(
    response: Callable[[Array], Complex], unseen: tuple[Array, Array], band_hz: tuple[float, float]
) -> float:
    """Return the share that a model leaves of an answer it was not fitted to.

    response: of the model, at Hz. Its answer is cut off where the recording ends.
    """
    u, a = unseen
    n = 4 * len(u)
    answer = irfft(response(rfftfreq(n, TS)) * rfft(u, n), n)[: len(u)]
    measured, modelled = (whole_record(u, one, 0.0).within(band_hz) for one in (a, answer))
    return scaled(modelled.H, measured).left


def explained(part: FrequencyResponse) -> Callable[[Complex], float]:
    """Return the function that tells how much modelled H (k,) explains of a response.

    It is 0 for a printer that follows its command exactly, and 1 for the response itself without
    what differs from one frequency to the next, as noise and harmonics do.
    """
    stiff: Complex = (np.sinc(part.hz * TS) ** 2).astype(complex)
    late = float(np.subtract(*delays([part, replace(part, H=stiff)])))
    in_time = part.H * np.exp(2j * np.pi * part.hz * late)
    step = float(np.median(np.diff(part.hz)))
    reach = np.arange(-3.0 * SMOOTHED_HZ, 3.0 * SMOOTHED_HZ + step, step)
    weight = np.exp(-((reach / SMOOTHED_HZ) ** 2) / 2.0)
    smooth = np.convolve(in_time * part.power, weight, "same")
    smooth = smooth / np.convolve(part.power, weight, "same")
    nearest = scaling(part)
    least = nearest(smooth * np.exp(-2j * np.pi * part.hz * late)).left ** 2
    most = max(nearest(stiff).left ** 2, least + 1e-9)
    return lambda H: (most - nearest(H).left ** 2) / (most - least)
