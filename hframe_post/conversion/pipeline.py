"""The tool in one look: a sliced file in, the same print with compensated commands out.

lines → gcode → lookahead → profile → compensate → settle → guard → dense_gcode → text
                                                           ↘ simulate → report
                                                           ↘ step_timing → step_file
                                                           ↘ sample_table
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from hframe_post import __version__
from hframe_post.arrays import TS, Array, E
from hframe_post.compensation.compensate import Compensator, compensate
from hframe_post.compensation.guard import clamp, guard
from hframe_post.compensation.settle import LEAD_SHARE, settle
from hframe_post.conversion.report import Report, StepReport
from hframe_post.errors import HframeError, PrinterError
from hframe_post.firmware.registry import player
from hframe_post.gcode.commands import STAMP, dialect
from hframe_post.gcode.reader import read
from hframe_post.planner.lookahead import plan
from hframe_post.planner.sampling import sample
from hframe_post.prediction.predict import judge
from hframe_post.printer.settings import Printer
from hframe_post.stream.chunks import stretches
from hframe_post.stream.prefetch import prefetch
from hframe_post.stream.types import Item, Moves, Passthrough, Pause, Rest, Rests, Samples, Standing
from hframe_post.writers.gcode import Late, Ledger, Output, write
from hframe_post.writers.samples import tabulate
from hframe_post.writers.step_file import MOTORS, Header, Lines, Note, written
from hframe_post.writers.steps import Counts, step

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
    commands = _commands(lines, printer, options, report)
    yield b"%s %s\n" % (STAMP, stamp(printer, options).encode())
    ledger, machine = Ledger(), player(printer, options.tolerance)
    output = write(commands, options.strategy, machine, ledger)
    for text in output:
        report.lines_written += 1 if isinstance(text, Late) else text.count(b"\n")
        yield text
    report.lines_written += 1  # the stamp
    report.busiest_second = ledger.busiest
    report.lines_per_second = machine.lines_per_second
    _conserved(ledger.filament, report, FILAMENT_TOLERANCE)


def convert_to_steps(
    lines: Iterable[bytes],
    printer: Printer,
    options: Options,
    report: Report,
    kind: str = "steps",
    inline: bool = False,
) -> Iterator[bytes | Note]:
    """The same as the steps of the motors: text of a step file, and notes for its events.

    kind: ``steps`` or ``step-bits``; inline: notes are lines of the text. Raises PrinterError
    where the profile does not say how the motors step.
    """
    table, kinematics = printer.steps, printer.kinematics
    if table is None:
        raise PrinterError("the table is missing: step timing needs it", "steps", printer.name)
    commands = _commands(lines, printer, options, report)
    lengths = (table.belt, table.belt, table.z, table.e)
    header = Header(
        kind, __version__, printer.name, settings_hash(printer, options), table.clock_hz, lengths,
        kinematics.matrix,
    )  # fmt: skip
    counts, count = Counts(), Lines()
    steps = step(commands, options.strategy, kinematics, table, counts)
    yield from written(steps, header, inline, count)
    report.lines_written = count.all
    motors = dict(zip(MOTORS, counts.steps.tolist(), strict=True))
    report.steps = StepReport(count.rows, counts.ticks, table.clock_hz, motors)
    # a step that is not due yet at the end of a stretch is made in the next one
    tolerance = FILAMENT_TOLERANCE + counts.starts * table.e
    _conserved(counts.net[MOTORS.index("E")] * table.e + counts.passed, report, tolerance)


def convert_to_samples(
    lines: Iterable[bytes], printer: Printer, options: Options, report: Report
) -> Iterator[Array]:
    """The same as tables of path, command and predicted motion, one row a millisecond."""
    commands = extruded(_commands(lines, printer, options, report), report)
    for table in tabulate(commands, options.strategy, printer.plant):
        report.lines_written += len(table)
        yield table
    _conserved(report.filament_after, report, FILAMENT_TOLERANCE)


def _commands(
    lines: Iterable[bytes], printer: Printer, options: Options, report: Report
) -> Iterator[Samples]:
    """Safe commands, computed ahead in threads of their own; the report is kept."""
    compensator = prepared(printer)
    commands = prefetch(commanded(counted(lines, report), printer, compensator, options, report))
    if options.predict:
        commands = prefetch(predicted(commands, printer, report))
    return timed(commands, report)


def _conserved(filament: float, report: Report, tolerance: float) -> None:
    report.filament_after = filament
    lost = report.filament_before - filament
    if abs(lost) > tolerance:
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
    items = measured(read(lines, dialect(printer.firmware.dialect), options.file_limits), report)
    samples = sample(plan(items, limits), limits, rests(printer, compensator))
    commands = settle(compensate(samples, compensator, options.strategies), chosen, tolerance)
    checks = (chosen, printer.travel, printer.motors, printer.kinematics, report.peaks)
    return guard(clamp(commands, *checks) if options.clamp else commands, *checks)


def prepared(printer: Printer) -> Compensator:
    """The printer's compensator, certified. Raises PrinterError."""
    try:
        return Compensator(printer.plant, printer.compensation.windows)
    except ValueError as error:
        raise PrinterError(str(error), "compensation", printer.name) from None


def rests(printer: Printer, compensator: Compensator) -> Rests:
    """Standstill that the fastest stop and start on this bed can need."""
    limits, tolerance = printer.limits, printer.compensation.settle_tolerance
    lever = max(abs(edge - printer.plant.x_c) for edge in printer.travel.x)
    return compensator.rests(limits.velocity, limits.acceleration, lever, LEAD_SHARE * tolerance)


def stamp(printer: Printer, options: Options) -> str:
    """Version, printer and settings: what made the output."""
    return f"{__version__}, printer {printer.name}, settings {settings_hash(printer, options)}"


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
    for judgement in judge(commands, printer.plant, JUDGED_EVERY):
        report.add_errors(judgement.contour)
        yield judgement.block


def extruded(commands: Iterable[Samples], report: Report) -> Iterator[Samples]:
    """The commands as they are; their filament, and that of lines passed on, is reported."""
    for stretch in stretches(commands):
        last: float | None = None
        for block in stretch:
            if len(block):
                start = float(block.xyze[0, E]) if last is None else last
                last = float(block.xyze[-1, E])
                report.filament_after += last - start
            for event in block.events:
                if isinstance(event, Pause) and isinstance(event.action, Passthrough):
                    report.filament_after += event.action.filament
            yield block


def timed(commands: Iterable[Samples], report: Report) -> Iterator[Samples]:
    """The commands as they are; print time with and without the rests is reported."""
    resting = 0
    for block in commands:
        resting += sum(event.samples for event in block.events if isinstance(event, Rest))
        report.time_after = block.end * TS
        report.time_before = (block.end - resting) * TS
        yield block
