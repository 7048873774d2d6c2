"""A whole file: its spans of planned motion, commands for all of it, and the report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import fields

from hframe_post.compensation.guard import check_prediction
from hframe_post.conversion.ledger import FileNotes, Ledger
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain, Stages, read_ahead
from hframe_post.conversion.print_report import Report
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.conversion.spans import Spans
from hframe_post.errors import HframeError
from hframe_post.gcode.limits import with_motors
from hframe_post.model.strategies import Compensator
from hframe_post.printer.settings import Limits, Printer
from hframe_post.stream.tally import joined
from hframe_post.stream.types import Samples


class PlannedFile:
    """A file as spans of planned motion, and a ledger of what it asks for."""

    def __init__(self, lines: Iterable[bytes], chain: Chain) -> None:
        self._lines, self._chain, self._options = lines, chain, chain.options
        self._notes = FileNotes(chain.firmware.dialect.label)
        self._sliced = SlicedFile(chain.sliced.printer, chain.sliced)
        self._following = chain.following()
        self._within = chain.within_motors()

    @property
    def sliced_seconds(self) -> float:
        """Return how long the firmware takes for what was read so far, as sliced."""
        return self._sliced.own.seconds

    def spans(self) -> Spans:
        """Yield the spans; use up each before taking the next. Raises HframeError."""
        notes, chain = self._notes, self._chain
        items = read_ahead(notes.items(chain.read(self._lines, notes)))
        plans = chain.scheduled(self._sliced.items(items), self._following, self._within)
        return Spans(plans, chain.firmware.advance())

    @property
    def ledger(self) -> Ledger:
        """Return what was noted of the file so far."""
        notes, own, slowed = self._notes, self._sliced.own, self._following
        return Ledger(
            read=notes.read, path=notes.path,
            slowed=self._within.share, sliced_s=own.seconds, elsewhere=own.elsewhere,
            following=None if slowed is None else (slowed.share, slowed.least),
        )  # fmt: skip

    def report(self, rest: Ledger) -> Report:
        """Return the report of a conversion whose later stages noted the rest.

        Raises HframeError if the model predicts an error that no working printer has.
        """
        printer, options, ledger = self._chain.printer, self._options, joined(self.ledger, rest)
        contour, width, shaping, share = ledger.contour, ledger.width, None, 1.0
        if self._judges_today:
            today = self._sliced.today(live=options.picture)
            contour, width = {**contour, **today.contour}, {**width, **today.width}
            shaping, share = today.shaping, today.share
        if "none" in contour:
            check_prediction(contour["none"].rms)
        noted = {each.name: getattr(ledger, each.name) for each in fields(Ledger)}
        return Report(
            **noted | {"contour": contour, "width": width}, strategy=options.strategy,
            shaping=shaping, predicted_sliced=share,
            couples=printer.kinematics.racks and printer.plant.Gxtheta is not None,
            notices=tuple(printer.warnings()) if options.strategy != "none" else (),
            capped=_binds(self._chain.caps),
            other_tools=printer.firmware.other_tools,
        )  # fmt: skip

    @property
    def _judges_today(self) -> bool:
        return "none" in (self._options.predict or ()) and self._options.strategy != "none"

    def check_filament(self, written: float, late: float = 0.0) -> None:
        """Raise HframeError unless all filament read was written, both in mm.

        late: mm of filament that may still be missing or too much.
        """
        lost = self._notes.read.filament - written
        if abs(lost) > 1e-3 + late:
            raise HframeError(f"{lost:.4f} mm of filament would be lost; nothing was written")


def _binds(caps: Limits) -> bool:
    """Return whether limits of a profile bind what a file asks."""
    asked = caps.velocity, caps.acceleration, caps.square_corner_velocity
    return any(map(math.isfinite, asked))


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
        chain = Chain(printer, options)
        self._source = PlannedFile(lines, chain)
        self._stages = Stages(chain, compensator or chain.compensator, strategies)
        self.check_filament = self._source.check_filament

    def __iter__(self) -> Iterator[Samples]:
        """Yield commands with prediction."""
        return self._stages.predicted(self.computed())

    def computed(self) -> Iterator[Samples]:
        """Yield the commands alone: no prediction, no print time."""
        return self._stages.whole(self._source.spans())

    @property
    def ledger(self) -> Ledger:
        """Return what was noted of the commands taken so far."""
        return self._stages.ledger

    def report(self) -> Report:
        """Return what is known of the commands taken so far."""
        return self._source.report(self.ledger)
