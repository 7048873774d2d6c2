"""Figures that run along with a stream: for the whole of it, by layer and by feature.

Nothing here grows with the length of the print: sums, peaks and histograms with fine
logarithmic bins, one set a layer and feature.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import Array, Flags, Integers

BINS_PER_E = 100  # bins of 1 % for the percentiles
BINS = 22 * BINS_PER_E  # up to 0.3 m
SMALLEST = 1e-7  # mm; errors below share the first bin
DECIMALS = 4


def _bins(errors: Array) -> Integers:
    """The bin of each error (n,)."""
    bins = BINS_PER_E * np.log(np.maximum(errors, SMALLEST) / SMALLEST)
    return np.minimum(bins.astype(np.int64), BINS - 1)


@dataclass
class ErrorStatistics:
    """RMS, percentiles and peak of a stream of errors (mm)."""

    count: int = 0
    squares: float = 0.0
    peak: float = 0.0
    histogram: NDArray[np.int32] = field(default_factory=lambda: np.zeros(BINS, np.int32))

    def add(self, errors: Array) -> None:
        """Takes the next errors, (n,), none negative."""
        self._add(errors, _bins(errors))

    def _add(self, errors: Array, bins: Integers) -> None:
        if len(errors):
            self.count += len(errors)
            self.squares += float(errors @ errors)
            self.peak = max(self.peak, float(errors.max()))
            self.histogram += np.bincount(bins, minlength=BINS).astype(np.int32)

    def join(self, other: ErrorStatistics) -> None:
        """Takes what another part of the stream has counted."""
        self.count += other.count
        self.squares += other.squares
        self.peak = max(self.peak, other.peak)
        self.histogram += other.histogram

    @property
    def rms(self) -> float:
        """Root mean square, mm."""
        return float(np.sqrt(self.squares / self.count)) if self.count else 0.0

    def percentile(self, share: float) -> float:
        """The error (mm) that ``share`` of all stay below, to 1 %."""
        if not self.count:
            return 0.0
        k = int(np.searchsorted(np.cumsum(self.histogram), share * self.count))
        return min(SMALLEST * float(np.exp((k + 1) / BINS_PER_E)), self.peak)

    def micrometres(self) -> dict[str, float]:
        """RMS, 95th percentile and peak in µm."""
        values = {"rms": self.rms, "p95": self.percentile(0.95), "peak": self.peak}
        return {name: round(value * 1e3, DECIMALS) for name, value in values.items()}


@dataclass
class ContourErrors:
    """Contour errors (mm) while extruding, which a part shows, and of all motion.

    rms, micrometres and the like tell of the former, unless nothing is ever extruded.
    """

    extruding: ErrorStatistics = field(default_factory=ErrorStatistics)
    all: ErrorStatistics = field(default_factory=ErrorStatistics)

    def add(self, errors: Array, extruding: Flags) -> None:
        """Takes the next errors of motion, (n,), of which some count as extruding, (n,)."""
        bins = _bins(errors)
        self.extruding._add(errors[extruding], bins[extruding])
        self.all._add(errors, bins)

    def join(self, other: ContourErrors) -> None:
        """Takes what another part of the stream has counted."""
        self.extruding.join(other.extruding)
        self.all.join(other.all)

    @property
    def shown(self) -> ErrorStatistics:
        """What is judged."""
        return self.extruding if self.extruding.count else self.all

    @property
    def rms(self) -> float:
        """Root mean square of what is judged, mm."""
        return self.shown.rms

    def micrometres(self) -> dict[str, Any]:
        """RMS, 95th percentile and peak in µm of what is judged; ``all``: of all motion."""
        return {**self.shown.micrometres(), "all": self.all.micrometres()}


@dataclass
class Figures:
    """One strategy in one part of the print.

    tracking: sum of squares of x and y off the desired place at the same time, mm².
    velocity, acceleration: greatest of any belt, mm/s, mm/s².
    """

    contour: ContourErrors = field(default_factory=ContourErrors)
    tracking: Array = field(default_factory=lambda: np.zeros(2))
    velocity: float = 0.0
    acceleration: float = 0.0

    def add_errors(self, contour: Array, tracking: Array, extruding: Flags) -> None:
        """Takes contour errors (n,), tracking errors (n, 2), and which extrude, (n,)."""
        self.contour.add(contour, extruding)
        self.tracking += np.square(tracking).sum(axis=0)

    def add_rates(self, velocity: Array, acceleration: Array) -> None:
        """Takes speeds and accelerations of the faster belt, (n,) each."""
        self.velocity = max(self.velocity, float(velocity.max(initial=0.0)))
        self.acceleration = max(self.acceleration, float(acceleration.max(initial=0.0)))

    def tracking_rms(self) -> Array:
        """Root mean square of the tracking error in x and y, (2,), mm."""
        return np.sqrt(self.tracking / max(self.contour.all.count, 1))

    def as_json(self) -> dict[str, Any]:
        """Lengths in µm, belts in mm/s and mm/s²."""
        x, y = (self.tracking_rms() * 1e3).tolist()
        return {
            "contour_error_um": self.contour.micrometres(),
            "tracking_error_um": {"x": round(x, DECIMALS), "y": round(y, DECIMALS)},
            "peak_belt_speed": round(self.velocity, 3),
            "peak_belt_acceleration": round(self.acceleration, 1),
        }
