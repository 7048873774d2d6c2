"""Layers and features (walls, infill, …) of a print, from the comments of the slicers."""

from __future__ import annotations

import re
from dataclasses import dataclass

from hframe_post.stream.marks import recent

_LAYER = re.compile(
    rb"\s*;[\s;(<\[-]*(?:layer[\s:#]+(?P<number>-?\d{1,9})(?![\d.])"  # Cura, ideaMaker, Kiri:Moto
    rb"|layer num/total_layer_count:\s*(?P<counted>\d{1,9})(?!\d)"  # Bambu Studio, from 1
    rb"|(?:LAYER_CHANGE|CHANGE_LAYER)\s*$"  # PrusaSlicer and its relatives
    rb"|BEGIN_LAYER_OBJECT z=|layer:\d+\.\d)"  # KISSlicer; FlashPrint, by height
    rb"|\s*[;(]\s*Slice (?P<slice>\d{1,9})(?=[, ])",  # MakerBot and Sailfish
    re.IGNORECASE,
)
_FEATURE = re.compile(
    rb"\s*;\s*(?:(?:TYPE|FEATURE):|feature (?=[a-z])|structure:)\s*(.*\S)"  # also Simplify3D
    rb"|\s*;\s*'([^']+)', [\d.]+ \[feed"  # KISSlicer
)

# each line that one of these matches has one of these words
PLACE_WORDS = b"layer|slice|type:|feature|structure|'"

TRAVEL = "travel"  # extrudes nothing
OTHER = "other"  # an unknown name

# The first kind whose word occurs in the name without punctuation counts.
_KINDS = (
    ("ironing", ("ironing",)),
    ("bridge", ("bridge", "overhang")),
    ("interface", ("interface",)),
    ("support", ("support",)),
    ("skirt", ("skirt", "brim", "raft", "primetower", "wipetower", "purge", "custom")),
    ("outer-wall", ("wallouter", "externalperimeter", "outerwall", "outerperimeter")),
    ("inner-wall", ("wallinner", "perimeter", "innerwall", "innerperimeter", "wall", "loop")),
    ("skin", ("skin", "topsurface", "bottomsurface", "solidinfill", "solidfill", "toplayer",
              "solid", "surface")),
    ("infill", ("fill",)),
)  # fmt: skip
KINDS = tuple(kind for kind, _ in _KINDS)


def kind(name: str) -> str:
    """Return the kind of a feature by its slicer's name; ``OTHER`` if the name is unknown."""
    plain = re.sub(r"[^a-z]", "", name.lower())
    return next((kind for kind, words in _KINDS if any(w in plain for w in words)), OTHER)


@recent
def feature(text: bytes) -> str | None:
    """Return the name of the feature that begins at a line; None if none does."""
    if match := _FEATURE.match(text):
        return (match[1] or match[2]).decode("utf-8", "replace")
    return None


@dataclass
class Place:
    """The present layer and feature in a print.

    layer: counted from 1 in the order of printing; 0 before the first. name: the number that the
    slicer gives the layer, or a count from 0 where it only marks the start (``;LAYER_CHANGE``).
    If objects are printed one at a time, several layers have the same name. feature: its name.
    """

    layer: int = 0
    name: str = ""
    feature: str = ""

    def mark(self, text: bytes) -> bool:
        """Read a line; return whether it names a layer or feature."""
        match = _LAYER.match(text)
        if match is None:
            named = feature(text)
            self.feature = named or self.feature
            return named is not None
        number = match["number"] or match["slice"]
        if match["counted"] is not None:
            name = str(int(match["counted"]) - 1)
        elif number is not None:
            name = number.decode()
        else:
            name = str(int(self.name) + 1) if self.name else "0"
        self.layer += name != self.name  # Bambu Studio says it twice
        self.name = name
        return True
