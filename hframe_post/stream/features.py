"""What slicers call the parts of a layer, and which of a few kinds each name means."""

from __future__ import annotations

import re

FEATURE = re.compile(rb"\s*;\s*(?:TYPE|FEATURE):\s*(.*\S)")
NEW_LAYER = re.compile(rb"\s*;\s*(?:LAYER:\s*-?\d|LAYER_CHANGE\s*$|CHANGE_LAYER\s*$)")

TRAVEL = "travel"  # lays down nothing
OTHER = "other"  # of no known name

# In this order: the first kind of which a word occurs in the name, without its punctuation
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
    """The kind of a feature by the name that a slicer gives it; ``OTHER`` if that says nothing."""
    plain = re.sub(r"[^a-z]", "", name.lower())
    return next((kind for kind, words in _KINDS if any(w in plain for w in words)), OTHER)
