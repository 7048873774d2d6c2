"""The tool in one look: a sliced file in, the same print with compensated commands out.

lines → gcode → lookahead → profile → compensate → settle → guard → dense_gcode → text
                                                           ↘ simulate → report
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from hframe_post import __version__
from hframe_post.ahead import ahead
from hframe_post.compensate import Compensator, compensate
from hframe_post.dense_gcode import Late, Ledger, Output, write
from hframe_post.dialect import STAMP
from hframe_post.errors import HframeError, PrinterError
from hframe_post.gcode import read
from hframe_post.guard import clamp, guard
from hframe_post.klipper import Dialect, StreamLimits
from hframe_post.lookahead import plan
from hframe_post.printer import Printer
from hframe_post.profile import sample
from hframe_post.report import Report
from hframe_post.settle import LEAD_SHARE, settle
from hframe_post.simulate import contour_errors
from hframe_post.stream import TS, E, Item, Moves, Rest, Samples, Standing

JUDGED_EVERY = 2  # samples; 500 Hz is far above what a printer rings at
FILAMENT_TOLERANCE = 1e-3  # mm over a whole print; more is an error, not a rounding


@dataclass(frozen=True, slots=True)
class Options:
    """What a user chooses beside the printer.

    strategy: what is written; predict: strategies whose contour error is reported;
    file_limits: whether the file's own limits lower the printer's; clamp: whether a command
    beyond a limit is taken back instead of being an error; tolerance: mm of decimation, None
    for every sample.
    """

    strategy: str
    predict: tuple[str, ...] = ()
    file_limits: bool = True
    clamp: bool = False
    tolerance: float | None = 0.002

    @property
    def strategies(self) -> tuple[str, ...]:
        """Every strategy that must be computed."""
        return tuple(dict.fromkeys((self.strategy, *self.predict)))


def convert(
    lines: Iterable[bytes], printer: Printer, options: Options, report: Report
) -> Iterator[Output]:
    """The whole conversion, streaming in constant memory. Raises HframeError.

    ``report`` is complete once the output has been used up.
    """
    compensator = prepared(printer)
    yield b"%s %s, printer %s, settings %s\n" % (
        STAMP,
        __version__.encode(),
        printer.name.encode(),
        settings_hash(printer, options).encode(),
    )
    commands = ahead(commanded(counted(lines, report), printer, compensator, options, report))
    if options.predict:
        commands = ahead(predicted(commands, printer, report))
    limits = StreamLimits.of(printer.limits, printer.motors, printer.kinematics)
    dialect = Dialect(printer.firmware, limits)
    ledger = Ledger()
    output = write(timed(commands, report), options.strategy, dialect, options.tolerance, ledger)
    for text in output:
        report.lines_written += 1 if isinstance(text, Late) else text.count(b"\n")
        yield text
    report.lines_written += 1  # the stamp
    report.filament_after = ledger.filament
    if abs(report.filament_after - report.filament_before) > FILAMENT_TOLERANCE:
        lost = report.filament_before - report.filament_after
        raise HframeError(f"{lost:.4f} mm of filament would be lost; nothing was written")


def commanded(
    lines: Iterable[bytes],
    printer: Printer,
    compensator: Compensator,
    options: Options,
    report: Report,
) -> Iterator[Samples]:
    """Safe commands for the motors, one sample a millisecond."""
    limits, chosen = printer.limits, options.strategy
    tolerance = printer.compensation.settle_tolerance
    lever = max(abs(edge - printer.plant.x_c) for edge in printer.travel.x)
    rests = compensator.rests(limits.velocity, limits.acceleration, lever, LEAD_SHARE * tolerance)
    items = measured(read(lines, printer.firmware.dialect, options.file_limits), report)
    samples = sample(plan(items, limits), limits, rests)
    commands = settle(compensate(samples, compensator, options.strategies), chosen, tolerance)
    checks = (chosen, printer.travel, printer.motors, printer.kinematics, report.peaks)
    return guard(clamp(commands, *checks) if options.clamp else commands, *checks)


def prepared(printer: Printer) -> Compensator:
    """The printer's compensator, certified. Raises PrinterError."""
    try:
        return Compensator(printer.plant, printer.compensation.windows)
    except ValueError as error:
        raise PrinterError(str(error), "compensation", printer.name) from None


def settings_hash(printer: Printer, options: Options) -> str:
    """Identifies all that decides the output beside the input."""
    deciding = (printer.digest, replace(options, predict=()))
    return hashlib.sha256(repr(deciding).encode()).hexdigest()[:12]


# ---------------------------------------------------------------------- the report


def counted(lines: Iterable[bytes], report: Report) -> Iterator[bytes]:
    """The lines as they are, counted."""
    for report.lines_read, line in enumerate(lines, 1):
        yield line


def measured(items: Iterable[Item], report: Report) -> Iterator[Item]:
    """The items as they are; moves and filament are counted."""
    for item in items:
        if isinstance(item, Moves):
            report.moves += len(item.line)
            report.filament_before += float(item.points[-1, E] - item.points[0, E])
        elif isinstance(item, Standing):
            report.moves += 1
            report.filament_before += item.end[E] - item.start[E]
        else:
            report.filament_before += item.filament
        yield item


def predicted(commands: Iterable[Samples], printer: Printer, report: Report) -> Iterator[Samples]:
    """The commands as they are; how well the nozzle follows is reported."""
    for block, errors in contour_errors(commands, printer.plant, JUDGED_EVERY):
        report.add_errors(errors)
        yield block


def timed(commands: Iterable[Samples], report: Report) -> Iterator[Samples]:
    """The commands as they are; print time with and without the rests is reported."""
    rests = 0
    for block in commands:
        rests += sum(event.samples for event in block.events if isinstance(event, Rest))
        report.time_after = block.end * TS
        report.time_before = (block.end - rests) * TS
        yield block
