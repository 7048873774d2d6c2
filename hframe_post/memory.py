"""Memory that is free goes back to the system."""

from __future__ import annotations

import ctypes
import gc
import sys


def give_back() -> None:
    """What was freed here and there by glibc's allocator, which else keeps it for this process.

    After work that made and dropped many arrays that is more than what the next work needs.
    """
    gc.collect()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # other C libraries have none
        if trim is not None:
            trim(0)
