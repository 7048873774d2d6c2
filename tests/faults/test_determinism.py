"""Equal input gives equal bytes, in whatever process: jobs, hash seeds, BLAS kernels."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT, SAMPLES
from tests.gcode_tools import SPANS

KERNELS = ("Prescott", "Nehalem", "Sandybridge", "Haswell")  # that any machine of ten years runs


def converted(source: Path, jobs: int = 1, seed: int = 0, blas: str = "") -> bytes:
    """The output of a process of its own."""
    env = {**os.environ, "PYTHONHASHSEED": str(seed)}
    if blas:
        env["OPENBLAS_CORETYPE"] = blas
    command = [sys.executable, "-m", "hframe_post", str(source), "-q", "-o", "-"]
    done = subprocess.run(
        [*command, "--jobs", str(jobs)], cwd=ROOT, env=env, capture_output=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")
    return done.stdout


@pytest.mark.slow
def test_neither_processes_nor_hashes_show(tmp_path: Path) -> None:
    source = tmp_path / "part.gcode"
    source.write_bytes(SPANS)
    assert converted(source, jobs=2, seed=1) == converted(source)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cube.gcode", "rectangle.gcode"])
def test_every_process_writes_the_same(name: str) -> None:
    source = SAMPLES / name
    plain = converted(source)
    for jobs, seed in ((1, 4294967295), (2, 1), (4, 0)):
        assert converted(source, jobs, seed) == plain, (jobs, seed)
    for blas in KERNELS:
        assert converted(source, blas=blas) == plain, blas
