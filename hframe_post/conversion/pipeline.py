"""The whole tool from top to bottom: each stage consumes what the one above it yields.

    lines of a file
      → read          moves, and the lines between them
      → scheduled     the pace, if an error was asked for; look-ahead: speeds along the path
      → sampled       the path, one sample a millisecond
      → compensated   commands for the motors, which dwell where the machine stops
      → checked       within the model's reach, the bed and the motors' limits (or clamped)
      → predicted     contour error; print time

Conversions and studies all use these stages. A ``Chain`` gives each of them what it needs of the
printer and of the options, ``Stages`` runs those from samples on and keeps a ledger;
``whole_file.py`` joins all.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from hframe_post.compensation.advance import Advancing
from hframe_post.compensation.compensate import compensate, hardest
from hframe_post.compensation.guard import Guard, check_deviation, check_model
from hframe_post.compensation.stops import StopModels, dwell_at_stops, stop_rules
from hframe_post.conversion.ledger import Ledger, SampleNotes
from hframe_post.conversion.options import Options
from hframe_post.errors import PrinterError
from hframe_post.firmware.dialect import NO_ADVANCE, Advance
from hframe_post.firmware.registry import firmware
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.model.strategies import Compensator
from hframe_post.planner.lookahead import plan
from hframe_post.planner.motors import FollowedAdvance, WithinMotors, with_ramps
from hframe_post.planner.pacing import Pace
from hframe_post.planner.sampling import sample
from hframe_post.planner.sliced import ShortMoves
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.error_meter import ErrorMeter
from hframe_post.prediction.predict import COMPENSATING, Played
from hframe_post.prediction.statistics import Labels
from hframe_post.prediction.windows import WHOLE
from hframe_post.printer.settings import Motors, Printer
from hframe_post.stream.chunks import ended, successive
from hframe_post.stream.features import Place
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Item, Moves, Passthrough, Planned, Position, Samples
from hframe_post.writers.gcode import GcodeWriter, rehearsed

if TYPE_CHECKING:
    from hframe_post.prediction.picture import Picture

MOVES_AHEAD = 1 << 16  # read before the first is planned, of 64 bytes: 4 MB, some 3 MB of a file

# ---------------------------------------------------------------------- the stages


class Chain:
    """The stages of a conversion: each gets what it needs of a printer and of the options.

    printer: with limits at the pace that the options ask for; sliced: as the file is sliced for it.
    caps: limits that no file may raise, at that pace.
    """

    def __init__(self, printer: Printer, options: Options) -> None:
        as_sliced = options.strategy == "none" or options.pace != 1.0
        walls = 1.0 if as_sliced else printer.outer_walls
        self.options, self._pace = options, Pace(options.pace, *printer.fastest_path, walls)
        self.sliced = firmware(printer)
        self.printer = replace(printer, limits=self._pace.limits(printer.limits))
        self.firmware = firmware(self.printer)
        caps = self._pace.limits(self.sliced.caps())
        self.caps = with_ramps(caps, printer.motors.stated)

    @cached_property
    def compensator(self) -> Compensator:
        """Return the compensator, its windows certified. Raises PrinterError."""
        return prepared(self.printer)

    @cached_property
    def at_stops(self) -> StopModels:
        """Return what the stops of the options' strategies have in common."""
        return self.stop_models(self.options.strategies)

    def stop_models(self, names: tuple[str, ...]) -> StopModels:
        """Return what the stops of these strategies have in common, which takes a while."""
        own = self.printer
        return StopModels(self.compensator, names, own.travel, own.motors, own.kinematics)

    def read(
        self, lines: Iterable[bytes], note: Callable[[str, str], None] | None = None
    ) -> Iterator[Item]:
        """Read G-code. note: takes what is strange in it, its kind first. Raises HframeError."""
        options = self.options
        own = ReadOptions.from_printer(self.sliced.printer, options.limits, options.extrusion)
        return read(lines, own if note is None else replace(own, note=note))

    def planned(self, lines: Iterable[bytes]) -> Iterator[Planned]:
        """Read G-code and plan the speeds along its path. Raises HframeError."""
        return self.scheduled(self.read(lines))

    def scheduled(self, items: Iterable[Item]) -> Iterator[Planned]:
        """Plan the speeds of moves at the pace asked for.

        Plan them so that the motors can follow, and the extruder its advance.
        """
        items, followed = self._pace.items(items), self.following
        items = items if followed is None else followed.items(items)
        items = self.within_motors.items(items)
        own = self.sliced.limits()
        if not own.least:
            return plan(items, self.caps)
        joined = ShortMoves(own.least, own.step, own.motors).joined_travel(items)
        return plan(joined, self.caps, joins=own.joins, late=own.late if own.joins else 0.0)

    @cached_property
    def within_motors(self) -> WithinMotors:
        """Return what slows moves down so that the motors can follow."""
        printer, motors, harder = self.printer, self.printer.motors.stated, 1.0
        if math.isfinite(motors.belt_acceleration):
            place = np.mean([printer.travel.x, printer.travel.y], axis=1)
            compensated = self.compensator, self.options.strategy
            harder = hardest(*compensated, printer.kinematics, place)
        return WithinMotors(motors, printer.kinematics, harder)

    @cached_property
    def following(self) -> FollowedAdvance | None:
        """Return what lowers accelerations for the extruder; None if the firmware does it."""
        own = self.firmware
        if (limits := own.motion(None).extruder) is None:
            return None
        return FollowedAdvance(own.advance(), limits, self.caps.acceleration)

    def sampled(self, items: Iterable[Planned], skip_slow: bool = False) -> Iterator[Samples]:
        """Sample planned motion, with the rest that the strategy needs at stops.

        skip_slow: leave out samples of slow motion, as ``sample`` does.
        """
        options, printer = self.options, self.printer
        rules = self.firmware.motion(options.tolerance)
        rests = stop_rules(printer.compensation.stops, options.strategy, rules.stop_rules)
        return sample(items, self.caps, rests, skip_slow=skip_slow)


def read_ahead(items: Iterator[Item]) -> Iterator[Item]:
    """Yield the items once many have been read: a file's faults come before the work.

    A move of its end code that leaves the bed is refused at once, unless the print is very long.
    """
    waiting, moves = deque[Item](), 0
    for item in items:
        waiting.append(item)
        if isinstance(item, Moves):
            moves += len(item.line) + 4 * len(item.marks)
        elif isinstance(item, Marks):
            moves += 4 * len(item)
        else:
            moves += 8 + (len(item.text) // 64 if isinstance(item, Passthrough) else 0)
        if moves >= MOVES_AHEAD:
            break
    while waiting:
        yield waiting.popleft()
    yield from items


@dataclass(frozen=True, slots=True)
class Beginning:
    """The state of the machine at the beginning of a span.

    place: x, y, z, e in mm; None if the output does not control the machine, as at the start.
    offset: the user's G92, mm. printing: layer and feature. advance: in force.
    """

    place: Position | None = None
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    printing: Place = field(default_factory=Place)
    advance: Advance = NO_ADVANCE


class Stages:
    """The stages from planned motion to checked commands, and a ledger of what they did.

    strategies: to compute; the options' by default. beginning: of a span that becomes lines; None:
    commands become samples, whose errors are judged in the same way for all of the print. played:
    of strategies whose lines are judged.
    """

    def __init__(
        self, chain: Chain, strategies: tuple[str, ...] = (), beginning: Beginning | None = None
    ) -> None:
        printer, options, own = chain.printer, chain.options, chain.firmware
        start = beginning or Beginning(advance=own.advance())
        self._chain, self._lines = chain, beginning is not None
        self._strategies = strategies or options.strategies
        self._at_stops = chain.stop_models(strategies) if strategies else chain.at_stops
        # without compensation a file moves as the firmware plays it today
        motors = printer.motors if options.strategy != "none" else Motors()
        checked = (printer.travel, motors, printer.kinematics)
        self._guard = Guard(*checked, options.clamp)
        rules = own.motion(options.tolerance)
        self._advancing = Advancing(start.advance, rules.extruder)
        picture = _picture(replace(start.printing)) if options.picture else None
        whole = None if not self._lines else 0 if start.place else WHOLE
        lines = self._lines and bool(options.predict)
        of = [name for name in self._strategies if name in COMPENSATING] if lines else []
        self.played = {name: Played(name) for name in of}
        self._rehearsed = [
            GcodeWriter(name, rules, own.code(), 0, start.place, start.offset, played=played)
            for name, played in self.played.items() if name != options.strategy
        ]  # fmt: skip
        self._errors = ErrorMeter(
            printer.plant, doubts=Doubts.from_plant(printer.plant, printer.uncertainty),
            picture=picture, whole=whole, played=[*self.played.values()],
        )  # fmt: skip
        self._notes = SampleNotes()

    def commands(self, items: Iterable[Planned]) -> Iterator[Samples]:
        """Yield commands for planned motion that are safe for the machine.

        The first sample is number 0. Raises HframeError for others.
        """
        chain, options = self._chain, self._chain.options
        skip_slow = self._lines and options.tolerance is not None
        commands = self.compensated(chain.sampled(items, skip_slow))
        own = chain.printer
        commands = check_deviation(commands, options.strategy, own.plant, own.limits)
        return self._guard.check(commands, options.strategy)

    def whole(self, spans: Iterable[Iterable[Planned]]) -> Iterator[Samples]:
        """Yield checked commands for a print; the spans continue each other. Raises HframeError."""
        streams = map(self.commands, spans)
        return successive(streams if self._chain.printer.plant.bed is None else map(ended, streams))

    def compensated(self, samples: Iterable[Samples]) -> Iterator[Samples]:
        commands = compensate(samples, self._chain.compensator, self._strategies)
        return dwell_at_stops(commands, self._at_stops)

    def predicted(self, commands: Iterable[Samples]) -> Iterator[Samples]:
        """Add advance; measure contour error and print time, on the way to the output."""
        commands = self._advancing.samples(commands)
        if self._chain.options.predict:
            commands = rehearsed(self._errors.samples(commands), self._rehearsed)
        return self._notes.samples(commands)

    def ledger(self) -> Ledger:
        """Return what was noted of all samples, once all were taken."""
        notes, errors = self._notes, self._errors
        errors.end()
        return Ledger(
            samples=notes.end, judged=errors.judged,
            filament_out=notes.filament, peaks=self._guard.peaks, clamped=self._guard.clamped,
            advancing=self._advancing.summary, contour=errors.contour,
            width=errors.width, picture=errors.picture,
        )  # fmt: skip


def _picture(printing: Place) -> Picture:
    from hframe_post.prediction.picture import Picture

    return Picture(Labels(printing))


def prepared(printer: Printer) -> Compensator:
    """Return the compensator for a printer, its windows certified. Raises PrinterError."""
    plant, windows = printer.plant, printer.compensation.windows
    try:
        check_model(plant, printer.limits)
        return Compensator(plant, windows)
    except PrinterError as error:
        raise PrinterError(error.cause, error.key, printer.name) from None
    except ValueError as error:
        raise PrinterError(str(error), "compensation", printer.name) from None
