"""Objects of a print, whose moves a firmware or its host leaves out once they are excluded.

The machine then stays where it was. Klipper makes up for what it left out in the first move of x or
y that it does not leave out, so that move must end where the sliced file's ends. A short segment of
a stream would begin where the excluded object ended. A file with a single object has no other to go
to.
"""

from __future__ import annotations

import re

from hframe_post.firmware.dialect import Dialect
from hframe_post.gcode.lines import Lines
from hframe_post.native.plain_lines import Known, digest

SEPARATORS = re.compile(rb"[^0-9A-Z-]+")
OUTSIDE = {b"", b"-1", b"NONMESH"}  # names that labels have for what belongs to no object


class Objects:
    """The object that is printed, by its labels.

    present: its number, a ``digest`` of its name; 0 for none. last: that of the last move in x or
    y. known: takes the labels as they are read.
    """

    def __init__(self, dialect: Dialect, source: Lines, known: Known) -> None:
        self.source, self.known = source, known
        self._label = dialect.label
        self._seen = set[int]()  # the first two
        self._looked = False  # ahead for a second
        self.present = self.last = 0

    @property
    def may_be_several(self) -> bool:
        """Return whether there is another object, or may be one."""
        return not self._looked or len(self._seen) > 1

    @property
    def left(self) -> bool:
        """Return whether moves before may be left out: there is another, or will be one soon."""
        if not self.last or self.present == self.last:
            return False
        if not self._looked and len(self._seen) == 1:
            for line in self.source.ahead():
                self._note(self._of(line.text) or 0)
        self._looked = True
        return len(self._seen) > 1

    def read(self, text: bytes) -> None:
        """Follow a line that may be a label."""
        if (number := self._of(text)) is not None:
            self.present = number
            self._note(number)
            self.known.learn(text, number)

    def moved(self) -> None:
        """Note a move of x or y, which is made wherever the machine was left."""
        self.last = self.present

    def _of(self, text: bytes) -> int | None:
        """Return the number of the object that a line begins, 0 where it ends one, or None."""
        if (label := self._label(text)) is None:
            return None
        # a comment and a command of the same object may differ in these
        name = SEPARATORS.sub(b"_", label.strip().upper())
        return 0 if name in OUTSIDE else digest(name)

    def _note(self, number: int) -> None:
        if number and len(self._seen) < 2:
            self._seen.add(number)
