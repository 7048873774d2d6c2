"""Every loop in C gives the same bits as its numpy twin, and so does the whole tool."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post import native
from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.options import Options
from hframe_post.errors import HframeError
from hframe_post.printer.settings import Printer
from tests.conftest import SAMPLES
from tests.native.cases import CASES, Case, joined_blocks, stops
from tests.native.comparing import copies, in_numpy, same

SLOW: dict[Case, int] = {stops: 15, joined_blocks: 25}  # examples
READING = {"plain_moves"}  # its twin is the whole reader, see test_reading


def outcome(function: Callable[..., Any], *arguments: Any) -> list[Any]:
    """Return the result, or the error's text, and the arguments as they are then."""
    arguments = copies(arguments)
    try:
        result = function(*arguments)
    except HframeError as error:
        result = str(error)
    arrays = [each for each in arguments if isinstance(each, np.ndarray)]
    return [result, *arrays]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_pair(case: Case, library: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    called = set[str]()

    class Noted:
        def __getattr__(self, name: str) -> Any:
            called.add(name)
            return getattr(library, name)

    monkeypatch.setattr(native, "built", Noted)

    @settings(max_examples=SLOW.get(case, 80), deadline=None)
    @given(st.integers(0, 2**32 - 1))
    def compare(seed: int) -> None:
        for call in case(np.random.default_rng(seed)):
            same(outcome(*call), in_numpy(outcome, *call))

    compare()
    assert called >= set(CASES[case])


def test_every_loop_is_compared(library: ModuleType) -> None:
    loops = {name for name in dir(library) if name[0].islower()}
    assert loops == {name for names in CASES.values() for name in names} | READING


def test_the_whole_tool(
    paper: Printer, library: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compare text and report for the first layers of a slice."""
    lines = (SAMPLES / "cube.gcode").read_bytes().splitlines(keepends=True)[:1200]
    options = Options("racking", ("none", "racking"))
    results = []
    for found in (None, library):
        monkeypatch.setattr(native, "built", lambda found=found: found)
        conversion = GcodeConversion(lines, paper, options)
        text = b"".join(piece for piece in conversion if isinstance(piece, bytes))
        results.append((text, conversion.report().as_text()))
    assert results[0] == results[1]
