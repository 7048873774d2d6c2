"""Objects of a print, whose moves a firmware or its host leaves out once they are excluded.

The machine then stays where it was. Klipper makes up for what it left out in the first move of x or
y that it does not leave out, so that move must end where the sliced file's ends. A short segment of
a stream would begin where the excluded object ended.
"""

from __future__ import annotations

from hframe_post.firmware.dialect import Dialect

OUTSIDE = {b"", b"-1", b"NONMESH"}  # names that labels have for what belongs to no object


class Objects:
    """The object that is printed, by its labels. left: whether moves before may be left out."""

    def __init__(self, dialect: Dialect) -> None:
        self._label = dialect.label
        self._name = self._last = b""  # the present object, and the last whose moves have passed
        self.left = False

    def read(self, text: bytes) -> None:
        """Follow a line that may be a label."""
        if (label := self._label(text)) is not None:
            name = label.strip().upper()
            self._name = b"" if name in OUTSIDE else name
            self.left = bool(self._last) and self._name != self._last

    def moved(self) -> None:
        """Note a move of x or y, which is made wherever the machine was left."""
        self._last, self.left = self._name, False
