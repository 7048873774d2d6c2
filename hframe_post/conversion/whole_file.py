"""A whole file: its spans of planned motion, commands for all of it, and the report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cached_property
from typing import ClassVar

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
from hframe_post.printer.settings import Printer
from hframe_post.stream.tally import joined
from hframe_post.stream.types import Samples


class WholeFile:
    """A file as spans of planned motion, what is noted of it, and the report of its conversion.

    spans: use up each before taking the next; they raise HframeError. done: what later stages have
    noted so far. played: whether a firmware plays the output.
    """

    played: ClassVar[bool] = False

    def __init__(self, lines: Iterable[bytes], printer: Printer, options: Options) -> None:
        lines, self.printer = with_motors(lines, printer, options.limits)
        self.chain = chain = Chain(self.printer, options)
        self._notes = notes = FileNotes()
        self._sliced = SlicedFile(self.printer, chain.sliced)
        self._following, self._within = chain.following(), chain.within_motors()
        items = self._sliced.items(read_ahead(notes.items(chain.read(lines, notes))))
        plans = chain.scheduled(items, self._following, self._within)
        self.spans = Spans(plans, chain.firmware.advance())
        self.done = Ledger()

    @property
    def times(self) -> tuple[float, float]:
        """Return the duration of the print so far as sliced and as converted, s."""
        return self._sliced.own.seconds, self.done.duration

    def report(self) -> Report:
        """Return the report, once the output was used up.

        Raises HframeError if the model predicts an error that no working printer has.
        """
        return self._report

    @cached_property
    def _report(self) -> Report:
        printer, options, caps = self.printer, self.chain.options, self.chain.caps
        notes, own, slowed = self._notes, self._sliced.own, self._following
        planned = Ledger(
            read=notes.read, path=notes.path,
            slowed=self._within.share, sliced_s=own.seconds, elsewhere=own.elsewhere,
            following=None if slowed is None else (slowed.share, slowed.least),
        )  # fmt: skip
        ledger = joined(planned, self.done)
        shaping, share = None, 1.0
        if "none" in (options.predict or ()) and options.strategy != "none":
            today = self._sliced.today(live=options.picture)
            shaping, share = today.shaping, today.share
            ledger = replace(
                ledger, contour={**ledger.contour, **today.contour},
                width={**ledger.width, **today.width},
            )  # fmt: skip
        if "none" in ledger.contour:
            check_prediction(ledger.contour["none"].rms)
        asked = caps.velocity, caps.acceleration, caps.square_corner_velocity
        player = self.chain.sliced if self.played else None
        notices = printer.warnings() if options.strategy != "none" else []
        return Report.from_ledger(
            ledger, printer=printer, options=options, player=player, shaping=shaping,
            notices=(*notices, *(player.code().notices if player else ())),
            capped=any(map(math.isfinite, asked)), predicted_sliced=share,
        )  # fmt: skip

    def check_filament(self, written: float, late: float = 0.0) -> None:
        """Raise HframeError unless all filament read was written, both in mm.

        late: mm of filament that may still be missing or too much.
        """
        lost = self._notes.read.filament - written
        if abs(lost) > 1e-3 + late:
            raise HframeError(f"{lost:.4f} mm of filament would be lost; nothing was written")


class Commands(WholeFile):
    """Safe commands for the motors of a whole file, streamed in constant memory.

    strategies: to compute; the options' by default.
    """

    def __init__(
        self, lines: Iterable[bytes], printer: Printer, options: Options,
        strategies: tuple[str, ...] = (), compensator: Compensator | None = None,
    ) -> None:  # fmt: skip
        super().__init__(lines, printer, options)
        self._stages = Stages(self.chain, compensator or self.chain.compensator, strategies)

    def computed(self) -> Iterator[Samples]:
        """Yield the commands alone: no prediction, no print time. Raises HframeError."""
        return self._stages.whole(self.spans)

    def predicted(self) -> Iterator[Samples]:
        """Yield the commands with prediction. Raises HframeError."""
        yield from self._stages.predicted(self.computed())
        self.done = self._stages.ledger


class SampleStream(Commands):
    """Commands with prediction; the report is complete once all were taken."""

    def __iter__(self) -> Iterator[Samples]:
        return self.predicted()
