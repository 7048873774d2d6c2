"""What a check uses is bounded, and a check that ends by itself is a defect."""

from __future__ import annotations

import os

import pytest

from tests.fuzz import apart as module
from tests.fuzz.apart import apart


def gone() -> str:
    os._exit(3)


def large() -> str:
    return f"{len(2 * module.BYTES * b'1')}"


def busy() -> str:
    while True:
        pass


def wrong() -> str:
    raise ValueError("so it is")


def test_what_comes_of_a_check() -> None:
    assert apart(lambda: "fine").word == "fine"
    assert "so it is" in apart(wrong).defect
    assert apart(gone).defect == "ended by itself, with status 3"
    assert "MB" in apart(large).defect


def test_time_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SECONDS", 1)
    assert apart(busy).defect.startswith("killed by SIGXCPU after 1")
