"""The choice of λ and L: contour error against belt acceleration, for one print.

Every candidate compensates the same planned samples and is judged on the printer's plant and on
random printers that differ a little. λ is λ of x; that of y keeps the profile's ratio.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import product
from statistics import median

import numpy as np

from hframe_post.arrays import TS, Z
from hframe_post.compensation.guard import check_model, max_deviation
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain, Stages
from hframe_post.model.kinematics import Differences, Kinematics
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.model.strategies import Compensator
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.error_meter import ErrorMeter
from hframe_post.prediction.statistics import ContourErrors
from hframe_post.printer.settings import Compensation, Motors, Printer
from hframe_post.stream.chunks import branches
from hframe_post.stream.types import Samples

KNOTS = (5, 8, 10, 20)  # L, samples between knots
EFFORTS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)  # λ of x
PREVIEW = 440  # samples of a window, L_C: as long for every L
RACKING = Options("racking", clamp=False)
ROUGHLY = 1.1  # costs this close to the least are as good; the gentlest of them is taken


@dataclass
class Trial:
    """One candidate and how it did.

    refused: why it cannot be used at all. contour: on the model, with its range if the model says
    how well it is known and no printers are drawn. drawn: errors on random printers. velocity,
    acceleration: of the belts, mm/s and mm/s². furthest: how far its commands are off the path,
    mm. seconds: duration of the motion it was tried on.
    """

    windows: tuple[Window, Window]
    refused: str = ""
    contour: ContourErrors = field(default_factory=ContourErrors)
    drawn: list[ContourErrors] = field(default_factory=list)
    velocity: float = 0.0
    acceleration: float = 0.0
    furthest: float = 0.0
    seconds: float = 0.0

    @property
    def robust(self) -> float:
        """Return the median RMS contour error (mm) of the random printers, or else of the model."""
        return median(statistics.expected for statistics in self.drawn or [self.contour])

    @property
    def worst(self) -> float:
        """Return the largest RMS contour error (mm) of the random printers, or else of the range
        of the model."""
        known = self.contour.range
        if self.drawn or known is None:
            return max(statistics.rms for statistics in self.drawn or [self.contour])
        return known.high

    @property
    def cost(self) -> float:
        """Return the error by which windows are compared, mm: the mean of that of the model, which
        the printer may be today, and that of printers that differ from it."""
        return (self.contour.rms + self.robust) / 2.0

    def within(self, motors: Motors) -> bool:
        return (
            not self.refused
            and self.velocity <= motors.belt_velocity
            and self.acceleration <= motors.belt_acceleration
        )


def candidates(
    compensation: Compensation, knots: Iterable[int] = KNOTS, efforts: Iterable[float] = EFFORTS
) -> list[tuple[Window, Window]]:
    """Return windows of x and y for every L and λ."""
    x, y = compensation.effort
    ratio = y / x if x > 0.0 and y > 0.0 else 1.0
    grid = []
    for L, effort in product(knots, efforts):
        n_C = -(-PREVIEW // max(L, 1))
        window = Window(L, n_C, n_C // 2, effort, compensation.degree)
        grid.append((window, replace(window, effort=float(f"{ratio * effort:.4g}"))))
    return grid


def tune(
    lines: Iterable[bytes],
    printer: Printer,
    grid: list[tuple[Window, Window]],
    drawn: list[Plant],
    options: Options = RACKING,
) -> list[Trial]:
    """Return a trial of every candidate, in one pass over the print. Raises HframeError."""
    chain = Chain(printer, options)
    return tried(chain.sampled(chain.planned(lines)), printer, grid, drawn)


def tried(
    samples: Iterable[Samples], printer: Printer, grid: list[tuple[Window, Window]],
    drawn: list[Plant],
) -> list[Trial]:  # fmt: skip
    """Return a trial of every candidate on samples of a path, in one pass. Raises HframeError."""
    check_model(printer.plant, printer.limits)
    trials = [Trial(windows) for windows in grid]
    compensators: list[tuple[Trial, Compensator]] = []
    for trial in trials:
        try:
            compensators.append((trial, Compensator(printer.plant, trial.windows)))
        except ValueError as error:
            trial.refused = str(error)
    running = (
        _tried(*pair, branch, printer, drawn)
        for pair, branch in zip(compensators, branches(samples, len(compensators)), strict=True)
    )
    for _ in zip(*running, strict=True):  # so that no branch falls behind
        pass
    furthest = max_deviation(printer.plant, printer.limits)
    for trial in trials:
        if trial.furthest > furthest:
            trial.refused = (
                f"its commands are up to {trial.furthest:.1f} mm off the path; the plant's "
                f"lag explains {furthest:.1f} mm"
            )
    return trials


def recommended(trials: list[Trial], motors: Motors) -> Trial | None:
    """Return the gentlest trial that is about as good as the best the motors can follow.

    Effort matters little on a wrong model. That alone would recommend one that leaves several times
    the error on an exact model.
    """
    able = [trial for trial in trials if trial.within(motors)]
    if not able:
        return None
    least = min(trial.cost for trial in able)
    good = [trial for trial in able if trial.cost <= ROUGHLY * least]
    return min(good, key=lambda trial: trial.acceleration)


def _tried(
    trial: Trial, compensator: Compensator, samples: Iterable[Samples], printer: Printer,
    drawn: list[Plant],
) -> Iterator[None]:  # fmt: skip
    commands = Stages(Chain(printer, RACKING), compensator=compensator).compensated(samples)
    doubts = None if drawn else Doubts.from_plant(printer.plant)
    meters = [ErrorMeter(printer.plant, doubts=doubts), *map(ErrorMeter, drawn)]
    streams = branches(_rated(commands, trial, printer.kinematics), len(meters))
    judged = (meter.samples(stream) for meter, stream in zip(meters, streams, strict=True))
    for _ in zip(*judged, strict=True):
        yield
    trial.contour, *trial.drawn = map(_contour, meters)


def _contour(meter: ErrorMeter) -> ContourErrors:
    return meter.contour.get("racking", ContourErrors())  # none if nothing moves


def _rated(chunks: Iterable[Samples], trial: Trial, kinematics: Kinematics) -> Iterator[Samples]:
    """Note in the trial how hard the belts are driven; yield the chunks unchanged."""
    differences = Differences(kinematics)
    for chunk in chunks:
        trial.seconds += TS * len(chunk)
        if len(chunk):
            rates = differences.rates(chunk.commands["racking"])
            trial.velocity = max(trial.velocity, float(np.abs(rates.belt_velocity).max()))
            acceleration = float(np.abs(rates.belt_acceleration).max())
            trial.acceleration = max(trial.acceleration, acceleration)
            distance = np.hypot(*(chunk.commands["racking"] - chunk.xyze[:, :Z]).T)
            trial.furthest = max(trial.furthest, float(distance.max()))
        if chunk.ends_stretch:
            differences = Differences(kinematics)
        yield chunk
