"""The stages of one span: planned items → samples → commands → stands → safe → predicted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from hframe_post.arrays import TS
from hframe_post.compensation.compensate import compensate
from hframe_post.compensation.guard import (
    Clamp,
    Clamped,
    Guard,
    Peaks,
    check_deviation,
    max_deviation,
)
from hframe_post.compensation.stops import hold_at_stops, rests, stop_solvers
from hframe_post.conversion.meters import Clock, ErrorMeter, PrintTime
from hframe_post.conversion.options import Options
from hframe_post.firmware.registry import player
from hframe_post.model.stop import StopSolver
from hframe_post.model.strategies import Compensator
from hframe_post.planner.sampling import sample
from hframe_post.prediction.statistics import ContourErrors
from hframe_post.printer.settings import Printer
from hframe_post.stream.prefetch import prefetch
from hframe_post.stream.timing import StageTimes, joined
from hframe_post.stream.types import Planned, Samples


@dataclass(slots=True)
class SpanSummary:
    """What the stages saw of a span, or of several.

    samples: all; resting: those in which the path stands for the command's sake. seconds: of the
    processor, by stage.
    """

    samples: int = 0
    resting: int = 0
    peaks: Peaks = field(default_factory=Peaks)
    clamped: Clamped = field(default_factory=Clamped)
    contour: dict[str, ContourErrors] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def time(self) -> PrintTime:
        """Of it all."""
        return PrintTime((self.samples - self.resting) * TS, self.samples * TS)

    def join(self, later: SpanSummary) -> None:
        """Takes what was seen of a later span."""
        self.samples += later.samples
        self.resting += later.resting
        one, other = self.peaks, later.peaks
        self.peaks = Peaks(
            max(one.belt_velocity, other.belt_velocity),
            max(one.belt_acceleration, other.belt_acceleration),
            (
                max(one.axis_acceleration[0], other.axis_acceleration[0]),
                max(one.axis_acceleration[1], other.axis_acceleration[1]),
            ),
        )
        self.clamped = self.clamped.joined(later.clamped)
        for name, errors in later.contour.items():
            self.contour.setdefault(name, ContourErrors()).join(errors)
        self.seconds = joined(self.seconds, later.seconds)


class Stages:
    """Safe commands for the motors, of one span after another; raises HframeError.

    strategies: whose commands are computed; at_stops: solvers for them that others used before,
    which remember much. ``summary``: what was seen of all that was taken.
    """

    def __init__(
        self,
        printer: Printer,
        options: Options,
        compensator: Compensator,
        strategies: tuple[str, ...],
        at_stops: dict[str, StopSolver] | None = None,
    ) -> None:
        self._printer, self._options = printer, options
        self._compensator, self._strategies = compensator, strategies
        self._solvers = at_stops or stop_solvers(compensator, strategies, printer)
        checked = (printer.travel, printer.motors, printer.kinematics)
        self._clamp, self._guard = Clamp(*checked), Guard(*checked, options.clamp)
        self._clock, self._errors = Clock(), ErrorMeter(printer.plant)
        self.times = StageTimes()

    def computed(self, items: Iterable[Planned]) -> Iterator[Samples]:
        """The commands as they are computed, the first sample being 0; neither judged nor timed."""
        options, limits, times = self._options, self._printer.limits, self.times
        lifts = player(self._printer, options.tolerance, options.retract == "moving").rests
        waits = rests(self._printer.compensation.stops, options.strategy, lifts)
        samples = times.timed("sample", sample(items, limits, waits))
        commands = compensate(samples, self._compensator, self._strategies)
        commands = hold_at_stops(times.timed("compensate", commands), self._solvers)
        furthest = max_deviation(self._printer.plant, limits)
        commands = check_deviation(times.timed("stand", commands), options.strategy, furthest)
        if options.clamp:
            commands = self._clamp.limit(commands, options.strategy)
        return times.timed("guard", self._guard.check(commands, options.strategy))

    def judged(self, commands: Iterable[Samples], threads: bool) -> Iterator[Samples]:
        """Commands on their way to the output; threads: one computes them, one predicts."""
        if threads:
            commands = prefetch(commands)
        if self._options.predict:
            commands = self.times.timed("predict", self._errors.samples(commands))
            commands = prefetch(commands) if threads else commands
        return self._clock.samples(commands)

    @property
    def summary(self) -> SpanSummary:
        """Of what has passed."""
        return SpanSummary(
            self._clock.end, self._clock.resting, self._guard.peaks, self._clamp.clamped,
            self._errors.contour, self.times.seconds,
        )  # fmt: skip
