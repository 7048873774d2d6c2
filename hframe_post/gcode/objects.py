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

SEPARATORS = re.compile(rb"[^0-9A-Z-]+")
OUTSIDE = {b"", b"-1", b"NONMESH"}  # names that labels have for what belongs to no object


class Objects:
    """The object that is printed, by its labels. left: whether moves before may be left out."""

    def __init__(self, dialect: Dialect, source: Lines) -> None:
        self._label, self._source = dialect.label, source
        self._names = set[bytes]()  # the first two
        self._looked = False  # ahead for a second
        self._name = self._last = b""  # the present object, and the last whose moves have passed
        self.left = False

    def read(self, text: bytes) -> None:
        """Follow a line that may be a label."""
        if (name := self._of(text)) is not None:
            self._name = name
            self._note(name)
            self.left = bool(self._last) and self._name != self._last and self._several()

    def moved(self) -> None:
        """Note a move of x or y, which is made wherever the machine was left."""
        self._last, self.left = self._name, False

    def _of(self, text: bytes) -> bytes | None:
        """Return the object that a line begins, b"" where it ends one, or None."""
        if (label := self._label(text)) is None:
            return None
        # a comment and a command of the same object may differ in these
        name = SEPARATORS.sub(b"_", label.strip().upper())
        return b"" if name in OUTSIDE else name

    def _note(self, name: bytes) -> None:
        if name and len(self._names) < 2:
            self._names.add(name)

    def _several(self) -> bool:
        """Return whether there is another object, perhaps soon after this one."""
        if len(self._names) == 1 and not self._looked:
            self._looked = True
            for line in self._source.ahead():
                self._note(self._of(line.text) or b"")
        return len(self._names) > 1
