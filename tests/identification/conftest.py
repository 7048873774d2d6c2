"""Profiles with short sweeps, and recordings of the paper's printer."""

from __future__ import annotations

from pathlib import Path

import pytest

from hframe_post.printer.settings import Printer
from tests.identification.bench import FAST, QUICK, SENSOR, Bench, Recorded


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    path = tmp_path / "quick.toml"
    path.write_text(QUICK)
    return path


@pytest.fixture(scope="session")
def taken(tmp_path_factory: pytest.TempPathFactory, paper: Printer) -> Recorded:
    folder = tmp_path_factory.mktemp("sweeps")
    profile = folder / "fast.toml"
    profile.write_text(FAST)
    bench = Bench(folder, paper.plant, profile, klipper=False)
    x = bench.runs("x", (80.0, 140.0, 200.0), SENSOR)
    (y,) = bench.runs("y", (140.0,), SENSOR)
    return Recorded(folder, x, y)
