"""A check has limits of time and memory, and a check that exits by itself is a defect."""

from __future__ import annotations

import os

import pytest

from tests.fuzz import child
from tests.fuzz.child import run_in_child


def gone() -> str:
    os._exit(3)


def large() -> str:
    return f"{len(2 * child.MAX_BYTES * b'1')}"


def busy() -> str:
    while True:
        pass


def wrong() -> str:
    raise ValueError("so it is")


def test_outcomes_of_a_check() -> None:
    assert run_in_child(lambda: "fine").word == "fine"
    assert "so it is" in run_in_child(wrong).defect
    assert run_in_child(gone).defect == "exited by itself with status 3"
    assert "MB" in run_in_child(large).defect


def test_time_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child, "MAX_SECONDS", 1)
    assert run_in_child(busy).defect.startswith("killed by SIGXCPU after 1")
