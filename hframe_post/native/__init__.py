"""Loops in C, as functions of Python with their constants.

``NAME.py`` defines the functions that everyone calls; the loops are in ``NAME.c``. A function that
only says what a loop takes and returns is ``compiled``. A loop takes numbers and arrays as they
are. The wrong type or layout raises TypeError; a length, a count or an index that does not fit the
others raises ValueError. Loops run without the global interpreter lock.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeVar

__all__ = ["BUILT_FOR", "compiled", "kernels"]

BUILT_FOR = 40  # as in kernels.h: raised whenever a signature changes

kernels: Any
try:
    kernels = import_module("hframe_post.native._kernels")
except ImportError:
    kernels = None
if kernels is None or kernels.BUILT_FOR != BUILT_FOR:
    raise ImportError(
        "the compiled part of hframe-post is missing or belongs to another version: install it "
        "again, with 'pipx install --force .' or 'pip install -e .' (docs/start.md)"
    )

Loop = TypeVar("Loop", bound=Callable[..., Any])


def compiled(declared: Loop) -> Loop:
    """Return the loop with the name of a function that has its signature and no body."""
    loop: Loop = getattr(kernels, declared.__name__)
    return loop
