"""The whole tool from top to bottom: each stage consumes what the one above it yields.

    lines of a file
      → parsed        read the G-code; set the pace, if a speed was asked for
      → planned       look-ahead: speeds along the path
      → sampled       the path, one sample a millisecond
      → compensated   commands for the motors, which dwell where the machine stops
      → checked       within the model's reach, the bed and the motors' limits (or clamped)
      → predicted     contour error; print time

Conversions and studies all use these stages. ``SampleStream`` joins them for a whole file.
"""

from __future__ import annotations

import hashlib
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from hframe_post.arrays import TS
from hframe_post.compensation.advance import AdvanceSummary, Advancing
from hframe_post.compensation.clamp import Clamp
from hframe_post.compensation.compensate import compensate
from hframe_post.compensation.guard import Guard, check_deviation, check_model, check_prediction
from hframe_post.compensation.stops import StopSolvers, dwell_at_stops, stop_rules
from hframe_post.conversion.meters import (
    BandMeter,
    Clock,
    ErrorMeter,
    InputMeter,
    MotionSummary,
    PrintTime,
)
from hframe_post.conversion.options import Options
from hframe_post.conversion.path_meter import PathMeter
from hframe_post.conversion.report import AdvanceReport, BandReport, Plastic, Report
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.conversion.spans import Spans
from hframe_post.errors import HframeError, PrinterError
from hframe_post.firmware.advance import Advance
from hframe_post.firmware.registry import firmware
from hframe_post.gcode.commands import STAMP
from hframe_post.gcode.motors import with_motors
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.model.strategies import Compensator
from hframe_post.planner.bands import TimeInBands, avoid_bands
from hframe_post.planner.extruder import FollowedAdvance
from hframe_post.planner.lookahead import plan
from hframe_post.planner.motors import WithinMotors
from hframe_post.planner.pacing import PieceStart, pace
from hframe_post.planner.sampling import sample
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.statistics import Labels
from hframe_post.printer.settings import Motors, Printer
from hframe_post.stream.chunks import ended, successive
from hframe_post.stream.features import Place
from hframe_post.stream.running import StageTimes, joined, prefetch
from hframe_post.stream.types import Item, Moves, Passthrough, Plan, Planned, Samples
from hframe_post.version import __version__

if TYPE_CHECKING:
    from hframe_post.prediction.picture import Picture

MOVES_AHEAD = 300_000  # read before the first is planned, of 64 bytes: 20 MB

# ---------------------------------------------------------------------- the stages


def parsed(lines: Iterable[bytes], printer: Printer, options: Options) -> Iterator[Item]:
    """Read G-code and set the pace of its moves. Raises HframeError."""
    return paced(_read(lines, printer, options), options)


def _read(lines: Iterable[bytes], printer: Printer, options: Options) -> Iterator[Item]:
    return read(lines, ReadOptions.from_printer(printer, options.limits, options.extrusion))


def read_ahead(items: Iterator[Item]) -> Iterator[Item]:
    """Yield the items once many have been read: a file's faults come before the work.

    A move of its end code that leaves the bed is refused at once, unless the print is very long.
    """
    waiting, moves = deque[Item](), 0
    for item in items:
        waiting.append(item)
        if isinstance(item, Moves):
            moves += len(item.line) + 4 * len(item.marks)
        else:
            moves += 8 + (len(item.text) // 64 if isinstance(item, Passthrough) else 0)
        if moves >= MOVES_AHEAD:
            break
    while waiting:
        yield waiting.popleft()
    yield from items


def paced(items: Iterator[Item], options: Options) -> Iterator[Item]:
    """Set the pace of moves, if a speed was asked for."""
    return items if options.paces is None else pace(items, options.paces)


def planned(lines: Iterable[bytes], printer: Printer, options: Options) -> Iterator[Planned]:
    """Read G-code and plan the speeds along its path. Raises HframeError."""
    return scheduled(parsed(lines, printer, options), printer)


def scheduled(
    items: Iterable[Item], printer: Printer, start: PieceStart | None = None,
    followed: FollowedAdvance | None = None, within: WithinMotors | None = None,
) -> Iterator[Planned]:  # fmt: skip
    """Plan the speeds of moves, so that the motors can follow, and the extruder its advance.

    They keep out of the bands that the profile's motors avoid. start: place of the first item in
    the print. followed: lowers the accelerations, as ``following`` gives it. within: slows moves
    down for the motors.
    """
    followed = followed or following(printer)
    items = items if followed is None else followed.items(items)
    items = (within or WithinMotors(printer)).items(items)
    return plan(avoid_bands(items, printer, start), firmware(printer).caps())


def following(printer: Printer, advance: Advance | None = None) -> FollowedAdvance | None:
    """Return what lowers accelerations for the extruder; None: the firmware adds its advance.

    advance: at the beginning; the profile's by default.
    """
    own = firmware(printer)
    if (limits := own.motion(None).extruder) is None:
        return None
    most = own.caps().acceleration
    return FollowedAdvance(advance or own.advance(), limits, most)


def sampled(
    items: Iterable[Planned], printer: Printer, options: Options, skip_slow: bool = False
) -> Iterator[Samples]:
    """Sample planned motion, with the rest that the strategy needs at stops.

    skip_slow: leave out samples of slow motion, as ``sample`` does.
    """
    rules = firmware(printer).motion(options.tolerance, options.retract == "moving")
    rests = stop_rules(printer.compensation.stops, options.strategy, rules.stop_rules)
    return sample(items, printer.limits, rests, skip_slow=skip_slow)


class Stages:
    """The stages from planned motion to checked commands, and a summary of what they did.

    strategies: to compute; the options' by default. at_stops: solvers reused from other stages with
    the same printer and compensator, because solvers cache their solutions. printing: layer and
    feature at the beginning. skip_slow: see ``sampled``. advance: pressure advance at the
    beginning; the profile's by default. whole: see ``ErrorMeter``; a picture shows all.
    """

    def __init__(
        self, printer: Printer, options: Options, compensator: Compensator,
        strategies: tuple[str, ...] = (), at_stops: StopSolvers | None = None,
        printing: Place | None = None, skip_slow: bool = False, advance: Advance | None = None,
        whole: int | None = None,
    ) -> None:  # fmt: skip
        self._skip_slow = skip_slow
        self._printer, self._options, self._compensator = printer, options, compensator
        self._strategies = strategies or options.strategies
        self._at_stops = at_stops or StopSolvers(compensator, self._strategies, printer)
        # without compensation a file moves as the firmware plays it today
        motors = printer.motors if options.strategy != "none" else Motors()
        checked = (printer.travel, motors, printer.kinematics)
        self._clamp, self._guard = Clamp(*checked), Guard(*checked, options.clamp)
        self._clock = Clock()
        picture = _picture(printing or Place()) if options.picture else None
        doubts = Doubts.from_plant(printer.plant, printer.uncertainty)
        own = firmware(printer)
        limits = own.motion(options.tolerance).extruder
        self._advancing = Advancing(advance or own.advance(), limits)
        self._errors = ErrorMeter(
            printer.plant, doubts=doubts, picture=picture, whole=None if picture else whole
        )
        self._walls = BandMeter(printer, self._options.strategy, printing or Place())
        self._meter = options.meters.begun(printing or Place()) if options.meters else None
        self.times = StageTimes()

    def commands(self, items: Iterable[Planned]) -> Iterator[Samples]:
        """Yield checked commands for planned motion; the first sample is number 0.

        Raises HframeError.
        """
        samples = sampled(items, self._printer, self._options, self._skip_slow)
        samples = self.times.timed("sample", samples)
        return self.checked(self.compensated(samples))

    def whole(self, spans: Spans) -> Iterator[Samples]:
        """Yield checked commands for a print; the spans continue each other. Raises HframeError."""
        return continued(spans, self.commands, self._printer)

    def compensated(self, samples: Iterable[Samples]) -> Iterator[Samples]:
        commands = compensate(samples, self._compensator, self._strategies)
        commands = dwell_at_stops(self.times.timed("compensate", commands), self._at_stops)
        return self.times.timed("dwell", commands)

    def checked(self, commands: Iterable[Samples]) -> Iterator[Samples]:
        """Yield commands that are safe for the machine. Raises HframeError for others."""
        strategy, printer = self._options.strategy, self._printer
        commands = check_deviation(commands, strategy, printer.plant, printer.limits)
        if self._options.clamp:
            commands = self._clamp.limit(commands, strategy)
        return self.times.timed("guard", self._guard.check(commands, strategy))

    def advanced(
        self, commands: Iterable[Samples], advance: Advance | None = None
    ) -> Iterator[Samples]:
        """Add pressure advance.

        advance: at the beginning of another stream, whose first sample is number 0 again.
        """
        return self.times.timed("advance", self._advancing.samples(commands, advance))

    def predicted(self, commands: Iterable[Samples], threads: bool) -> Iterator[Samples]:
        """Add advance; measure contour error and print time, on the way to the output.

        threads: compute the commands in one thread and the prediction in another, both ahead of
        the caller.
        """
        commands = self.advanced(commands)
        if threads:
            commands = prefetch(commands)
        if self._options.predict:
            if self._options.shaping is not None:
                from hframe_post.compensation.shape import SHAPER, shape

                commands = shape(commands, {SHAPER: self._options.shaping})
            commands = self.times.timed("predict", self._errors.samples(commands))
            commands = prefetch(commands) if threads else commands
        if self._meter is not None:
            commands = self.times.timed("measure", self._meter.samples(commands))
        return self._clock.samples(self._walls.samples(commands))

    @property
    def summary(self) -> MotionSummary:
        """Return the summary of all samples that were taken so far."""
        return MotionSummary(
            self._clock.end, self._clock.fed, self._clock.resting, self._guard.peaks,
            self._clamp.clamped, self._errors.contour, self._errors.width, self.times.seconds,
            self._errors.picture, self._advancing.summary, self._walls.time,
            self._meter.sums if self._meter is not None else None, self._errors.judged,
        )  # fmt: skip


def _picture(printing: Place) -> Picture:
    from hframe_post.prediction.picture import Picture

    return Picture(Labels(printing))


def continued(
    spans: Spans, commands: Callable[[Iterable[Planned]], Iterator[Samples]], printer: Printer
) -> Iterator[Samples]:
    """Yield the commands for the planned items of all spans as one stream."""
    streams = (commands(span.items) for span in spans)
    return successive(streams if printer.plant.bed is None else map(ended, streams))


class PlannedFile:
    """A file as spans of planned motion, and a summary of what it asks for."""

    def __init__(self, lines: Iterable[bytes], printer: Printer, options: Options) -> None:
        self._lines, self._printer, self._options = lines, printer, options
        self._input = InputMeter(firmware(printer).dialect.label)
        self._path = PathMeter(printer.limits, options.paces is not None)
        self._firmware, self._sliced = firmware(printer), SlicedFile(printer)
        self._times, self._following, self._ramps = StageTimes(), following(printer), 0.0
        self._within = WithinMotors(printer)

    @property
    def sliced_seconds(self) -> float:
        """Return how long the firmware takes for what was read so far, as sliced."""
        return self._sliced.own.seconds

    def spans(self) -> Spans:
        """Yield the spans; use up each before taking the next. Raises HframeError."""
        items = _read(self._input.lines(self._lines), self._printer, self._options)
        items = read_ahead(self._times.timed("read", self._input.items(items)))
        items = paced(self._sliced.items(items), self._options)
        items = self._path.items(items)
        plans = scheduled(items, self._printer, followed=self._following, within=self._within)
        plans = self._timed(plans)
        return Spans(self._times.timed("plan", plans), self._firmware.advance())

    def report(self, motion: MotionSummary) -> Report:
        """Return the report of a conversion that saw this motion.

        Raises HframeError if the model predicts an error that no working printer has.
        """
        contour, width, shaping, share = motion.contour, motion.width, None, 1.0
        if "none" in (self._options.predict or ()) and self._options.strategy != "none":
            today = self._sliced.today(live=self._options.picture)
            contour, width = {**contour, **today.contour}, {**width, **today.width}
            shaping, share = today.shaping, today.share
        if "none" in contour:
            check_prediction(contour["none"].rms)
        return Report(
            self._options.strategy, self._input.summary, self._path.summary,
            self._print_time(motion), motion.peaks, motion.clamped,
            contour, width, shaping=shaping, couples=bool(self._printer.plant.couplings),
            notices=tuple(self._printer.warnings()) if self._options.strategy != "none" else (),
            seconds=joined(self._times.seconds, motion.seconds), picture=motion.picture,
            plastic=self._plastic(motion.fed), other_tools=self._printer.firmware.other_tools,
            bands=self._bands(motion.in_bands), metered=motion.metered,
            predicted=(motion.judged or motion.samples) / max(motion.samples, 1),
            predicted_sliced=share,
        )  # fmt: skip

    def sliced_off(self) -> float:
        """Return by how much (mm RMS) whole steps put the sliced file off its path."""
        steps = self._printer.steps
        asked = "none" in (self._options.predict or ()) and self._options.strategy != "none"
        return self._sliced.off_in_steps(steps) if steps is not None and asked else 0.0

    def _timed(self, plans: Iterable[Planned]) -> Iterator[Planned]:
        """Add up the time of plans if nothing limited their jerk."""
        for item in plans:
            if isinstance(item, Plan):
                self._ramps += float(item.seconds.sum())
            yield item

    def _print_time(self, motion: MotionSummary) -> PrintTime:
        own = self._sliced.own
        return PrintTime(
            own.seconds + own.elsewhere,
            motion.duration + own.elsewhere,
            own.standing + self._ramps + own.elsewhere,
            TS * motion.resting,
            self._within.share,
        )

    def advance(self, found: AdvanceSummary) -> AdvanceReport | None:
        """Return what was done about pressure advance, if there is any."""
        if not found.most:
            return None
        limit, slowed = self._printer.limits.extruder_acceleration, self._following
        computed = slowed is not None
        share, least = (slowed.share, slowed.least) if slowed is not None else (0.0, math.inf)
        return AdvanceReport(found.least, found.most, computed, found.hardest, limit, share, least)

    def _bands(self, after: TimeInBands) -> BandReport | None:
        bands = self._printer.speed.avoid
        return BandReport(bands, self._sliced.own.in_bands, after) if bands else None

    def _plastic(self, fed: float) -> Plastic | None:
        bed, limits = self._printer.plant.bed, self._printer.limits
        if bed is None or self._options.strategy == "none":
            return None
        filament = limits.filament_diameter, limits.filament_density
        printed = self._input.summary.filament
        return Plastic(bed.mass, printed * bed.filament, fed * bed.filament, *filament)

    def check_filament(self, written: float, late: float = 0.0) -> None:
        """Raise HframeError unless all filament read was written, both in mm.

        late: mm of filament that may still be missing or too much.
        """
        lost = self._input.summary.filament - written
        if abs(lost) > 1e-3 + late:
            raise HframeError(f"{lost:.4f} mm of filament would be lost; nothing was written")


class SampleStream:
    """Safe commands for the motors of a whole file, streamed in constant memory.

    strategies: to compute; the options' by default. Iterating raises HframeError. The report is
    complete once all commands were taken.
    """

    def __init__(
        self, lines: Iterable[bytes], printer: Printer, options: Options,
        strategies: tuple[str, ...] = (), compensator: Compensator | None = None,
    ) -> None:  # fmt: skip
        lines, printer = with_motors(lines, printer, options.limits)
        self._printer = printer
        self._source = PlannedFile(lines, printer, options)
        self._stages = Stages(printer, options, compensator or prepared(printer), strategies)
        self.check_filament = self._source.check_filament

    def __iter__(self) -> Iterator[Samples]:
        """Yield commands with prediction, computed ahead in threads."""
        return self._stages.predicted(self.computed(), threads=True)

    def computed(self) -> Iterator[Samples]:
        """Yield the commands alone: no threads, no prediction, no print time."""
        return self._stages.whole(self._source.spans())

    def report(self) -> Report:
        """Return what is known of the commands taken so far."""
        return self._source.report(self._stages.summary)


# ---------------------------------------------------------------------- what identifies a result


def prepared(printer: Printer) -> Compensator:
    """Return the compensator for a printer, its windows certified. Raises PrinterError."""
    check_model(printer)
    try:
        return Compensator(printer.plant, printer.compensation.windows)
    except ValueError as error:
        raise PrinterError(str(error), "compensation", printer.name) from None


def stamp(printer: Printer, options: Options) -> str:
    """Return what made an output: version, printer and a hash of all settings."""
    return f"{__version__}, printer {printer.name}, settings {settings_hash(printer, options)}"


def first_line(printer: Printer, options: Options) -> bytes:
    """Return the first line in G-code of a conversion with these options, ``resolved``.

    A file that has it was converted by this version with the same profile and settings. Only the
    comments with which the sliced file begins precede it.
    """
    return b"%s %s\n" % (STAMP, stamp(printer, options).encode())


def settings_hash(printer: Printer, options: Options) -> str:
    """Return a hash of all that decides the output in addition to the input.

    Predictions do not change the output, and paces follow from the input and the speed asked for.
    """
    deciding = (printer.digest, replace(options, predict=(), paces=None))
    return hashlib.sha256(repr(deciding).encode()).hexdigest()[:12]
