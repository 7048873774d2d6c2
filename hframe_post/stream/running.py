"""How a process computes: with one BLAS thread, and with little memory."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread in the whole process; also works as a decorator.

    Sums are then taken in one order, so equal inputs give equal bytes. The matrices are too small
    to gain from more threads. The command line sees to it in the environment, before numpy asks:
    entering takes 12 ms.
    """
    if all(os.environ.get(name) == "1" for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")):
        yield
        return
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield


def keep_memory() -> None:
    """Let the allocator keep what this process frees, up to 64 MB, for the next chunk.

    Otherwise it returns each chunk to the system and gets it back page by page. Garbage is
    collected less often: few of the many objects of a conversion refer to each other in a circle.
    """
    gc.freeze()
    gc.set_threshold(50_000)  # new objects; 700 by default
    allocate = _c_function("mallopt")
    if allocate is not None:
        allocate(M_MMAP_THRESHOLD, 1 << 25)
        allocate(M_TRIM_THRESHOLD, 1 << 26)


def release_memory() -> None:
    """Return freed memory to the system, which the allocator keeps for this process."""
    gc.collect()
    trim = _c_function("malloc_trim")
    if trim is not None:
        trim(0)


def _c_function(name: str) -> Callable[..., int] | None:
    """Return a function of glibc; other C libraries do not have it."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None
