"""Resources of the process: the threads of the linear algebra, and free memory."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread in the whole process; also works as a decorator.

    Sums are then taken in one order, so equal inputs give equal bytes. The matrices are too small
    to gain from more threads. Entering takes 4 ms.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield


def release_memory() -> None:
    """Return freed memory to the system after work that made and dropped many arrays.

    Otherwise glibc's allocator keeps it for this process, and the next stage adds its own.
    """
    gc.collect()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # other C libraries have none
        if trim is not None:
            trim(0)
