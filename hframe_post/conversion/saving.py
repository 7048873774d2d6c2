"""What a print could lose of its time within the error that it has without compensation.

Every fifth layer is planned twice, as the firmware plans: as sliced, and with accelerations that
compensation allows, at the file's feed rates. The others can lose as large a share of their time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from hframe_post.firmware.base import FirmwareLimits
from hframe_post.firmware.registry import firmware
from hframe_post.gcode.slicer_settings import is_setting, slicer_settings
from hframe_post.planner.pacing import (
    ADJUSTED,
    CORNER,
    FIRST_LAYERS,
    Pace,
    Paces,
    PieceStart,
    pace,
)
from hframe_post.planner.sliced import SlicedTime
from hframe_post.printer.settings import Printer
from hframe_post.stream.features import TRAVEL, Place
from hframe_post.stream.types import Item, Moves, Passthrough
from hframe_post.writers.stream.print_time import duration

EVERY = 5  # layers, of which one is planned
ENOUGH = 3  # layers that must have been planned
MOST = 20_000  # moves and other items that are planned together, since a layer may have any number
WORTH_SECONDS, WORTH_SHARE = 60.0, 0.01  # from which a saving is shown
# mm, RMS, at 95 % or peak; within a smaller error, what is not known of the model slows the print
ENOUGH_ERROR = 0.05


@dataclass(frozen=True, slots=True)
class Saving:
    """seconds: that the print could lose. error: without compensation, mm."""

    seconds: float
    error: float

    @classmethod
    def worth_a_line(cls, lost: float, seconds: float, error: float) -> Saving | None:
        """Return the saving of a print that takes these seconds; None if small or not certain."""
        worth = lost >= max(WORTH_SECONDS, WORTH_SHARE * seconds) and error >= ENOUGH_ERROR
        return cls(lost, error) if worth else None

    def as_text(self) -> str:
        """Return a line for the summary."""
        micrometres = float(f"{1e3 * self.error:.2g}")
        return (
            f"could take       about {duration(self.seconds)} less within the error that it has "
            f"without compensation: --max-error {micrometres:g}um"
        )


class FasterTime:
    """Compares the times of layers that pass, as sliced and made faster on this printer.

    sliced: the time of all items, which pass it before.
    """

    def __init__(self, printer: Printer, sliced: SlicedTime) -> None:
        acceleration, corner = printer.fastest_path
        fast = Pace(acceleration, min(CORNER * acceleration, corner), 1.0)
        self._paces = Paces(dict.fromkeys((*ADJUSTED, TRAVEL), fast), first_layers=FIRST_LAYERS)
        self._rules = rules = firmware(printer).limits(printer)
        limits = replace(
            rules.limits,
            acceleration=max(rules.limits.acceleration, fast.acceleration),
            square_corner_velocity=max(rules.limits.square_corner_velocity, fast.corner),
        )
        self._fast_rules = replace(rules, limits=limits)
        self._least = printer.limits.min_layer_time
        self._sliced, self._unchanged = sliced, 0.0  # s of first layers
        self._place, self._begun = Place(), Place()
        self._items, self._count = list[Item](), 0  # from where it began, if they are planned
        self._settings = deque[bytes](maxlen=MOST)
        self._now = (0.0, 0.0)  # s of the present layer as sliced and faster
        self._times = list[tuple[int, float, float]]()  # layers, and these times

    def lost(self) -> float:
        """Return the seconds that the print could lose, once all items have passed."""
        said = slicer_settings(self._settings).layer_time
        least = self._least if said is None else said
        if sum(layers for layers, *_ in self._times) < ENOUGH:
            return 0.0
        lost = (
            before - max(after, min(before, layers * least))
            for layers, before, after in self._times
        )
        share = sum(lost) / sum(before for _, before, _ in self._times)
        return share * (self._sliced.seconds - self._unchanged)

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        layer = 0
        for item in items:
            if self._place.layer != layer:
                self._end_layer(layer)
                layer = self._place.layer
            if layer > FIRST_LAYERS and layer % EVERY == EVERY - 1:
                self._items.append(item)
            if isinstance(item, Moves):
                self._count += len(item.points)
                for mark in item.marks:
                    self._read(mark.text)
            elif isinstance(item, Passthrough):
                self._count += 1
                self._read(item.text)
            if self._count > MOST:
                self._plan()
            yield item
        self._end_layer(layer)

    def _read(self, text: bytes) -> None:
        if not self._place.mark(text) and is_setting(text):
            self._settings.append(text)

    def _end_layer(self, layer: int) -> None:
        self._plan()
        if layer <= FIRST_LAYERS:
            self._unchanged = self._sliced.seconds
        elif any(self._now):
            self._times.append((self._place.layer - layer or 1, *self._now))
        self._now = 0.0, 0.0

    def _plan(self) -> None:
        """Plan the items that were kept, and forget them."""
        if self._items:
            faster = pace(self._items, self._paces, PieceStart(self._begun))
            before, after = self._now
            before += _seconds(self._items, self._rules)
            self._now = before, after + _seconds(faster, self._fast_rules)
        self._items, self._count, self._begun = [], 0, replace(self._place)


def _seconds(items: Iterable[Item], rules: FirmwareLimits) -> float:
    time = SlicedTime(rules)
    for _ in time.items(items):
        pass
    return time.seconds
