"""What tests of compiled loops share: drawing cases, and comparing with numpy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hframe_post import native

seeds = st.integers(0, 2**32 - 1)
thorough = settings(
    max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def same(one: NDArray[Any], other: NDArray[Any]) -> None:
    assert one.dtype == other.dtype
    assert one.shape == other.shape
    assert one.tobytes() == other.tobytes()


def in_numpy(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a function computes without the compiled loops."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "built", lambda: None)
        return function(*arguments)
