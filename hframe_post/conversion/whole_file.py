"""A whole file: its spans of planned motion, what it becomes, how that is saved, and the report.

To add an output format, write a generator of ``WholeFile`` and a row of ``FORMATS``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import IO, Any

from hframe_post.arrays import Array
from hframe_post.compensation.guard import check_prediction
from hframe_post.conversion.ledger import FileTally, Ledger, StepTally
from hframe_post.conversion.options import TOLERANCE, Kind, Options, first_line, stamp
from hframe_post.conversion.pipeline import Chain, Stages, read_ahead
from hframe_post.conversion.print_report import Report
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.conversion.spans import Spans, written
from hframe_post.errors import HframeError, OptionError, PrinterError
from hframe_post.firmware.base import Firmware
from hframe_post.firmware.registry import firmware
from hframe_post.gcode.limits import with_motors
from hframe_post.gcode.lines import BINARY
from hframe_post.native.linear import one_blas_thread
from hframe_post.printer.profile import check_identified
from hframe_post.printer.settings import Printer
from hframe_post.stream.tally import joined
from hframe_post.stream.types import Samples
from hframe_post.version import __version__
from hframe_post.writers.gcode import GcodeSummary
from hframe_post.writers.outputs import Outputs, compressing
from hframe_post.writers.print_time import SUMMARY, Output, after_head, later, write_output
from hframe_post.writers.steps import StepGenerator
from hframe_post.writers.tables import (
    COLUMNS,
    EVENTS_HEADER,
    MOTORS,
    Header,
    Note,
    StepFileWriter,
    as_csv,
    inlined,
    tabulate,
    write_npz,
)


class WholeFile:
    """A file as spans of planned motion, and what it becomes: one of its generators is used up.

    They raise HframeError. done: what the stages after planning have noted so far.
    """

    def __init__(self, lines: Iterable[bytes], printer: Printer, options: Options) -> None:
        lines, self.printer = with_motors(lines, printer, options.limits)
        self.chain = chain = Chain(self.printer, options)
        self._read = read = FileTally()
        self._sliced = SlicedFile(self.printer, chain.sliced)
        items = self._sliced.items(read_ahead(read.items(chain.read(lines, read.note))))
        self.spans = Spans(chain.scheduled(items), chain.firmware.advance())
        self.done = Ledger()
        self._player: Firmware | None = None  # which plays what it becomes

    # ------------------------------------------------------------------ what it becomes

    def gcode(self) -> Iterator[Output]:
        """Return G-code for the printer's firmware, written span by span."""
        self._player = self.chain.sliced
        stamped = first_line(self.printer, self.chain.options)
        return after_head(self._spans_as_gcode(), stamped, SUMMARY)

    def _spans_as_gcode(self) -> Iterator[Output]:
        for span in written(self.chain, self.spans):
            begun = self.done.duration
            for piece in span.output:
                yield later(piece, begun)
            self.done = joined(self.done, span.ledger)
        self.check_filament(self.done.written.filament)

    def samples(self, strategies: tuple[str, ...] = ()) -> Iterator[Samples]:
        """Yield safe commands of these strategies, by default the options'; note their errors."""
        stages = Stages(self.chain, strategies)
        yield from stages.predicted(stages.whole(span.items for span in self.spans))
        self.done = stages.ledger()

    def rows(self) -> Iterator[Array]:
        """Yield tables of path, command and predicted motion, one row a millisecond."""
        chain, count = self.chain, 0
        for table in tabulate(self.samples(), chain.options.strategy, chain.printer.plant):
            count += len(table)
            yield table
        filament = self.done.filament_out
        self.done = replace(self.done, written=GcodeSummary(count, 0, filament))
        self.check_filament(filament)

    def steps(self) -> Iterator[bytes | Note]:
        """Yield text of a step file, and notes for its events.

        Raises PrinterError if the profile does not say how the motors step.
        """
        printer, options = self.printer, self.chain.options
        table, kinematics = printer.steps, printer.kinematics
        if table is None:
            cause = "the table is missing; step timing needs it"
            raise PrinterError(cause, "steps", printer.name)
        if not kinematics.z_is_separate:
            cause = (
                f"the motor of z moves with x on a {kinematics.type}: its steps cannot be written"
            )
            raise PrinterError(cause, "kinematics.type", printer.name)
        stepper = StepGenerator(options.strategy, kinematics, table)
        writer = StepFileWriter(Header(
            __version__, printer.name, options.digest(printer.digest), table.clock_hz,
            (table.belt, table.belt, table.z, table.e), kinematics.matrix,
        ))  # fmt: skip
        yield from writer.write(stepper.step(self.samples()))
        counts = stepper.counts
        filament = float(counts.net[MOTORS.index("E")] * table.e + counts.passed)
        motors = dict(zip(MOTORS, counts.steps.tolist(), strict=True))
        self.done = replace(
            self.done, written=GcodeSummary(writer.lines, 0, filament),
            steps=StepTally(writer.rows, counts.ticks, table.clock_hz, motors),
        )  # fmt: skip
        # a step that is not due at the end of a stretch is made in the next one
        self.check_filament(filament, late=counts.starts * table.e)

    # ------------------------------------------------------------------ what is said of it

    @property
    def times(self) -> tuple[float, float]:
        """Return the duration of the print so far as sliced and as converted, s."""
        return self._sliced.own.seconds, self.done.duration

    @cached_property
    def report(self) -> Report:
        """Return the report, once a generator was used up.

        Raises HframeError if the model predicts an error that no working printer has.
        """
        printer, options, caps = self.printer, self.chain.options, self.chain.caps
        own, slowed = self._sliced.own, self.chain.following
        planned = Ledger(
            read=self._read, slowed=self.chain.within_motors.share, sliced_s=own.seconds,
            elsewhere=own.elsewhere,
            following=None if slowed is None else (slowed.share, slowed.least),
        )  # fmt: skip
        ledger = joined(planned, self.done)
        shaping, share = None, 1.0
        if "none" in (options.predict or ()) and options.strategy != "none":
            today = self._sliced.today()
            shaping, share = today.shaping, today.share
            ledger = replace(
                ledger, contour={**ledger.contour, **today.contour},
                width={**ledger.width, **today.width},
            )  # fmt: skip
        if "none" in ledger.contour:
            check_prediction(ledger.contour["none"].rms)
        asked = caps.velocity, caps.acceleration, caps.square_corner_velocity
        notices = printer.warnings() if options.strategy != "none" else []
        return Report.from_ledger(
            ledger, printer=printer, options=options, player=self._player, shaping=shaping,
            notices=(*notices, *(self._player.code().notices if self._player else ())),
            capped=any(map(math.isfinite, asked)), predicted_sliced=share,
        )  # fmt: skip

    def check_filament(self, written: float, late: float = 0.0) -> None:
        """Raise HframeError unless all filament read was written, both in mm.

        late: mm of filament that may still be missing or too much.
        """
        lost = self._read.filament - written
        if abs(lost) > 1e-3 + late:
            raise HframeError(f"{lost:.4f} mm of filament would be lost; nothing was written")


# ---------------------------------------------------------------------- how it is saved


@dataclass(frozen=True, slots=True)
class Target:
    """Where a conversion is written, and the other files that appear together with it.

    path: None is standard output. instead_of: the input, which may be replaced.
    """

    outputs: Outputs
    path: Path | None
    instead_of: Path | None = None
    _files: dict[str, IO[bytes]] = field(default_factory=dict)

    def open(self, suffix: str = "") -> IO[bytes]:
        """Return the empty file, or for a suffix the one whose name has that in addition.

        What an earlier conversion wrote to it is dropped.
        """
        if suffix not in self._files:
            path, source = self.path, self.instead_of
            if path is not None and suffix:
                path, source = path.with_name(path.name + suffix), None
            self._files[suffix] = self.outputs.open(path, source)
        file = self._files[suffix]
        file.seek(0)
        file.truncate()
        return file


@dataclass(frozen=True, slots=True)
class Format:
    """One kind of output: what makes it of a file, and the function that saves it.

    save: takes what is made, the target and the file. suffixes: those that choose this format.
    """

    make: Callable[[WholeFile], Iterable[Any]]
    save: Callable[[Any, Target, WholeFile], None]
    suffixes: tuple[str, ...] = ()


@one_blas_thread()
def convert(
    lines: Iterable[bytes], target: Target | None, printer: Printer, options: Options
) -> Report:
    """Convert lines and write the target, which appears with its outputs.

    target None: nothing is written. Raises HframeError, OSError.
    """
    if target is not None and options.strategy != "none" and not options.force:
        check_identified(printer)
    chosen, file = FORMATS[options.format or "gcode"], WholeFile(lines, printer, options)
    pieces = chosen.make(file)
    if target is None:
        for _ in pieces:
            pass
    else:
        chosen.save(pieces, target, file)
    return file.report


def with_format(
    options: Options, printer: Printer, output: Path | None, source: Path | None
) -> Options:
    """Return the options with the format for ``output``, or for None: standard output.

    source: the input. Raises OptionError for what the format or the printer's firmware cannot have.
    """
    in_place = source is not None and output is not None and _is_same(source, output)
    kind = chosen_format(output, options.format)
    if in_place and kind != "gcode":
        raise OptionError(f"{kind} would replace the G-code: name an output file with -o")
    if options.tolerance != TOLERANCE and not (kind == "gcode" and firmware(printer).decimates):
        raise OptionError("--tolerance is for G-code for Klipper")
    return replace(options, format=kind, tolerance=options.tolerance if kind == "gcode" else None)


def _is_same(source: Path, target: Path) -> bool:
    return source.exists() and target.exists() and source.samefile(target)


def chosen_format(output: Path | None, asked: Kind | None) -> Kind:
    """Return the format for a file, or for None: standard output. Raises OptionError."""
    suffix, packing = _suffixes(output)
    by_suffix = next((name for name, known in FORMATS.items() if suffix in known.suffixes), None)
    kind: Kind = asked or by_suffix or "gcode"
    if suffix == BINARY:
        raise OptionError(f"{output}: binary G-code is not written: name a .gcode file")
    if suffix in TABLES and kind != "samples":
        raise OptionError(f"a {suffix} file holds samples, not {kind}")
    if packing and output is not None and (kind == "gcode" or suffix in TABLES):
        why = f"{suffix} is compressed already" if suffix in TABLES else "printers cannot read it"
        raise OptionError(
            f"{output}: {kind} is not written compressed, because {why}: leave out {packing}"
        )
    return kind


def _suffixes(path: Path | None) -> tuple[str, str]:
    """Return the suffix that chooses the format, and that of the compression."""
    suffixes = path.suffixes if path is not None else []
    packing = suffixes.pop() if suffixes and suffixes[-1] == ".gz" else ""
    return (suffixes[-1] if suffixes else ""), packing


def _save_gcode(pieces: Iterable[Output], target: Target, file: WholeFile) -> None:
    write_output(target.open(), pieces, lambda: file.times, lambda: file.report.as_text())


def _save_steps(pieces: Iterable[bytes | Note], target: Target, _: WholeFile) -> None:
    """Write the step file and, next to a regular file, the file of its events."""
    out = target.open()
    if target.path is None:
        out.writelines(inlined(pieces))
        return
    events = target.open(".events")
    events.write(EVENTS_HEADER)
    with compressing(out, _suffixes(target.path)[1]) as packed:
        for piece in pieces:
            if isinstance(piece, bytes):
                packed.write(piece)
            else:
                events.write(piece.line())


def _save_samples(tables: Iterable[Array], target: Target, file: WholeFile) -> None:
    kind, packing = _suffixes(target.path)
    out = target.open()
    if target.path is not None and kind == ".npz":
        made_by = stamp(file.printer, file.chain.options)
        write_npz(out, tables, COLUMNS, made_by, target.path.resolve().parent)
    else:
        with compressing(out, packing) as packed:
            packed.writelines(as_csv(tables))


TABLES = (".npz",)  # of samples, which are CSV under any other suffix
FORMATS: dict[Kind, Format] = {
    "gcode": Format(WholeFile.gcode, _save_gcode),
    "steps": Format(WholeFile.steps, _save_steps, (".csv",)),
    "samples": Format(WholeFile.rows, _save_samples, TABLES),
}
