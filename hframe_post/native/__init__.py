"""Loops in C, each next to a function that does the same in numpy.

``NAME.py`` defines the functions that everyone calls, with their constants. They run the loop of
``NAME.c`` if the extension was built, and numpy otherwise, which gives the same bits and takes
longer. A loop takes numbers and contiguous arrays as they are. The wrong type or layout raises
TypeError; a length, a count or an index that does not fit the others raises ValueError. Loops run
without the global interpreter lock.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from types import ModuleType

BUILT_FOR = 15  # as in kernels.h: raised whenever a signature changes

Kernel = Callable[..., int]


def kernel(name: str) -> Kernel | None:
    """Return the compiled loop of that name, or None if there is none on this machine."""
    return getattr(built(), name, None)


@cache
def built() -> ModuleType | None:
    """Return the compiled module, or None if it is missing or was built from other sources."""
    try:
        found = import_module("hframe_post.native._kernels")
    except ImportError:
        return None
    return found if found.BUILT_FOR == BUILT_FOR else None
