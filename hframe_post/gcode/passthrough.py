"""Lines that pass as they stand, with what the file believes of the firmware by then."""

from __future__ import annotations

from itertools import chain

from hframe_post.gcode.batching import Gathering
from hframe_post.gcode.coordinates import Coordinates
from hframe_post.gcode.extrusion import is_absolute
from hframe_post.gcode.feed import Feed
from hframe_post.gcode.lexer import Line
from hframe_post.gcode.lines import Lines
from hframe_post.stream.types import Handling, Passthrough

AT_THE_START = "the start"  # why the first moves' place is unknown


class Passing:
    """Passes lines on.

    cause: what made the place unknown; ran_macro: whether one ran that may have set modes.
    """

    def __init__(self, source: Lines, place: Coordinates, feed: Feed, items: Gathering) -> None:
        self._source, self._place, self._feed, self._items = source, place, feed, items
        self.cause, self.ran_macro = AT_THE_START, False

    def line(
        self,
        line: Line,
        handling: Handling,
        seconds: float = 0.0,
        filament: float = 0.0,
        path: float = 0.0,
        cause: str = "",
    ) -> None:
        """One line. seconds: of a dwell; filament, path: mm that it moves; cause: why as it stands.

        The stream has modes of its own. To leave it those of the file must be known, which a
        macro before the first motion may have set.
        """
        guessed = self.ran_macro and not self._place.e_told
        if guessed and self._items.any_motion and handling is Handling.RELEASE:
            self._place.tell_e(self.e_is_absolute(line))
        state = self._place.state(self._feed.rate)
        item = Passthrough(line.number, line.text, handling, state, seconds, filament, path, cause)
        self._items.pass_through(item)

    def e_is_absolute(self, line: Line) -> bool:
        """What E is, in a file that has not said so before the first."""
        absolute = is_absolute(chain([line], self._source.ahead()))
        if absolute is False and self.ran_macro:
            return False
        if absolute or (absolute is None and not self.ran_macro):
            return True
        raise line.error(
            "nothing before tells whether E is absolute (M82) or relative (M83), and a macro may "
            "have set it: say --extrusion absolute or --extrusion relative"
        )
