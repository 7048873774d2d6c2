"""Running error statistics of a stream: overall, by layer and by feature.

Memory does not grow with the length of the print: each layer and feature has sums, peaks and a
histogram with fine bins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import Array, E, Flags, Integers
from hframe_post.model.error_range import SUMS, ErrorRange, error_range
from hframe_post.stream.features import Place
from hframe_post.stream.marks import PLACES
from hframe_post.stream.types import Samples, said

# Bins of the percentiles: the leading bits of a float64, which grow with its value, so that no
# logarithm is needed. 128 bins are an octave.
BIN_BITS = 52 - 7
SMALLEST = 2.0**-20  # mm; smaller errors share the first bin
BINS = 28 * 128  # up to 256 mm
_FIRST = int(np.float64(SMALLEST).view(np.int64)) >> BIN_BITS
DECIMALS = 4
BEFORE = "before the first"  # layer or feature that no comment precedes
TRAVEL = "TRAVEL"  # motion without extrusion, whatever feature the comments name


@dataclass
class Labels:
    """Layers and features by number, as the slicer's comments name them.

    place: where in the print the first chunk begins. Layers of one name are one.
    """

    place: Place = field(default_factory=Place)
    layers: list[str] = field(default_factory=lambda: [BEFORE])
    features: list[str] = field(default_factory=lambda: [TRAVEL, BEFORE])
    _e: float = -np.inf  # filament at the last sample

    def runs(self, chunk: Samples) -> tuple[Integers, Integers]:
        """Return at which samples (r,) of the next chunk others begin, and their numbers (r, 2).

        The first is 0. Samples without extrusion are travel, whatever the comments say.
        """
        starts, numbers = [0], [self._current()]
        for event in chunk.events:
            for mark in said(event, PLACES):
                if self.place.mark(mark.text):
                    starts.append(max(mark.index - chunk.first, 0))
                    numbers.append(self._current())
        return np.array(starts), np.array(numbers)

    def number(self, chunk: Samples) -> tuple[Integers, Integers]:
        """Return the numbers of layer and feature of each sample of the next chunk, (n,) each."""
        starts, numbers = self.runs(chunk)
        numbers = numbers.repeat(np.diff(starts, append=len(chunk)), axis=0)
        layer, feature = numbers.T
        if len(chunk):
            e = chunk.xyze[:, E]
            feature[np.diff(e, prepend=self._e) <= 0.0] = self.features.index(TRAVEL)
            self._e = float(e[-1])
        return layer, feature

    def layer(self, name: str) -> int:
        """Return the number of the layer of that name, a new one if needed."""
        return _index(self.layers, name)

    def feature(self, name: str) -> int:
        """Return the number of the feature of that name, a new one if needed."""
        return _index(self.features, name)

    def _current(self) -> tuple[int, int]:
        return self.layer(self.place.name or BEFORE), self.feature(self.place.feature or BEFORE)


def _index(names: list[str], name: str) -> int:
    if names[-1] == name:  # the latest of a thousand layers is asked for most often
        return len(names) - 1
    if name not in names:
        names.append(name)
    return names.index(name)


@dataclass
class ErrorStatistics:
    """RMS, percentiles and peak of a stream of errors (mm), and their range.

    doubts (SUMS,): sums of ``products`` of some of these errors; zeros if the model is exact.
    """

    count: int = 0
    squares: float = 0.0
    peak: float = 0.0
    histogram: NDArray[np.int32] = field(default_factory=lambda: np.zeros(BINS, np.int32))
    doubts: Array = field(default_factory=lambda: np.zeros(SUMS))

    def add(self, errors: Array, weight: int = 1) -> None:
        """Add the next errors, (n,), none negative, each ``weight`` times."""
        if len(errors):
            bins = (np.maximum(errors, SMALLEST).view(np.int64) >> BIN_BITS) - _FIRST
            np.minimum(bins, BINS - 1, out=bins)
            self.count += weight * len(errors)
            self.squares += weight * float(np.square(errors).sum())
            self.peak = max(self.peak, float(errors.max()))
            self.histogram += weight * np.bincount(bins, minlength=BINS).astype(np.int32)

    def join(self, other: ErrorStatistics) -> None:
        self.count += other.count
        self.squares += other.squares
        self.peak = max(self.peak, other.peak)
        self.histogram += other.histogram
        self.doubts = self.doubts + other.doubts

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.squares / self.count)) if self.count else 0.0

    @property
    def range(self) -> ErrorRange | None:
        """Return the range of the RMS error; None if the model counts as exact."""
        known = self.count and self.doubts[0]
        return error_range(self.doubts, self.squares / self.count) if known else None

    @property
    def expected(self) -> float:
        """Return the median of the range of the RMS error, or the RMS error, mm."""
        return self.rms if self.range is None else self.range.median

    def percentile(self, share: float) -> float:
        """Return the error in mm that a given share of samples stays below, accurate to 1 %."""
        if not self.count:
            return 0.0
        k = int(np.searchsorted(np.cumsum(self.histogram), share * self.count))
        end = np.int64((k + 1 + _FIRST) << BIN_BITS).view(np.float64)
        return min(float(end), self.peak)

    def measured(self, measure: str) -> float:
        """Return a statistic of the errors, mm. measure: its name in ``MEASURES``."""
        return MEASURES[measure](self)

    def percents(self) -> dict[str, float]:
        """Return RMS and percentile of errors that are shares."""
        values = {"rms": self.rms, "p95": self.percentile(0.95)}
        return {name: round(100.0 * share, 2) for name, share in values.items()}

    def micrometres(self) -> dict[str, float]:
        values = {name: measured(self) for name, measured in MEASURES.items()}
        if (found := self.range) is not None:
            values |= {"median": found.median, "from": found.low, "to": found.high}
        return {name: round(value * 1e3, DECIMALS) for name, value in values.items()}


# statistics by their names in every JSON
MEASURES: dict[str, Callable[[ErrorStatistics], float]] = {
    "rms": lambda errors: errors.rms,
    "p95": lambda errors: errors.percentile(0.95),
    "peak": lambda errors: errors.peak,
}


@dataclass
class ContourErrors:
    """Contour errors (mm) while extruding, which a part shows, and of all motion.

    rms and micrometres are those while extruding, unless nothing is ever extruded.
    """

    extruding: ErrorStatistics = field(default_factory=ErrorStatistics)
    all: ErrorStatistics = field(default_factory=ErrorStatistics)

    def add(self, errors: Array, extruding: Flags, weight: int = 1) -> None:
        """Add the next errors of motion, (n,), and whether each was made while extruding, (n,).

        weight: how many times each counts.
        """
        self.extruding.add(errors[extruding], weight)
        self.all.add(errors, weight)

    def doubt(self, products: Array, extruding: Flags, weight: int = 1) -> None:
        """Add what is not known of some errors, (n, SUMS), each ``weight`` times."""
        products = weight * products
        self.extruding.doubts = self.extruding.doubts + products[extruding].sum(axis=0)
        self.all.doubts = self.all.doubts + products.sum(axis=0)

    def join(self, other: ContourErrors) -> None:
        self.extruding.join(other.extruding)
        self.all.join(other.all)

    @property
    def shown(self) -> ErrorStatistics:
        """Return the statistics while extruding, or of all motion if nothing was extruded."""
        return self.extruding if self.extruding.count else self.all

    @property
    def rms(self) -> float:
        return self.shown.rms

    @property
    def range(self) -> ErrorRange | None:
        return self.shown.range

    @property
    def expected(self) -> float:
        return self.shown.expected

    def as_text(self) -> str:
        """Return the RMS error in µm, with its range if it has one."""
        text = f"{1e3 * self.expected:.1f} µm RMS"
        if (known := self.range) is None:
            return text
        return f"{text} ({1e3 * known.low:.1f} to {1e3 * known.high:.1f} as the printer changes)"

    def micrometres(self) -> dict[str, Any]:
        return {**self.shown.micrometres(), "all": self.all.micrometres()}


@dataclass
class Figures:
    """Results of one strategy in one part of the print.

    width: shares by which the line's width is off. tracking: sums of squared deviations in x and y
    from the desired place at the same time, mm².
    velocity, acceleration: greatest of any belt, mm/s, mm/s².
    """

    contour: ContourErrors = field(default_factory=ContourErrors)
    width: ErrorStatistics = field(default_factory=ErrorStatistics)
    tracking: Array = field(default_factory=lambda: np.zeros(2))
    velocity: float = 0.0
    acceleration: float = 0.0

    def add_errors(self, contour: Array, tracking: Array, extruding: Flags) -> None:
        """Add contour errors (n,), tracking errors (n, 2), and which are while extruding, (n,)."""
        self.contour.add(contour, extruding)
        self.tracking += np.square(tracking).sum(axis=0)

    def add_rates(self, velocity: Array, acceleration: Array) -> None:
        """Add speeds and accelerations of the faster belt, (n,) each."""
        self.velocity = max(self.velocity, float(velocity.max(initial=0.0)))
        self.acceleration = max(self.acceleration, float(acceleration.max(initial=0.0)))

    def tracking_rms(self) -> Array:
        """Return the root mean square of the tracking error in x and y, (2,), mm."""
        return np.sqrt(self.tracking / max(self.contour.all.count, 1))

    def as_json(self) -> dict[str, Any]:
        """Return the figures for a JSON report: lengths in µm, belts in mm/s and mm/s²."""
        x, y = (self.tracking_rms() * 1e3).tolist()
        return {
            "contour_error_um": self.contour.micrometres(),
            "line_width_error_percent": self.width.percents(),
            "tracking_error_um": {"x": round(x, DECIMALS), "y": round(y, DECIMALS)},
            "peak_belt_speed": round(self.velocity, 3),
            "peak_belt_acceleration": round(self.acceleration, 1),
        }
