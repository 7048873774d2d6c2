"""No arguments make a compiled loop leave its arrays, however little they fit each other."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

CALLS, ROUNDS = Path(__file__).with_name("bad_arguments.py"), "1000"


@pytest.mark.slow
def test_loops_refuse_what_does_not_fit(library: ModuleType) -> None:
    """Counts, lengths, indices, types and layouts: wrong alone, and two or three at once."""
    assert library.__file__ is not None
    command = [sys.executable, str(CALLS), library.__file__, ROUNDS]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    calls = "\n".join(result.stdout.splitlines()[-3:])
    assert result.returncode == 0, f"{calls}\n{result.stderr[-2000:]}"
    assert calls.endswith("all loops survived")
