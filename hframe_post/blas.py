"""Linear algebra in one thread: equal bytes need sums in one order."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_thread() -> Iterator[None]:
    """While it lasts, BLAS has one thread, in the whole process; also a decorator.

    The matrices are too small to gain from more. Looking for the libraries takes 4 ms.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield
