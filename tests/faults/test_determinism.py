"""Equal input gives equal bytes, in whatever process: jobs, hash seeds, BLAS kernels, loops."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest

from tests.conftest import ROOT, SAMPLES
from tests.faults.test_signals import SPANS

KERNELS = ("Prescott", "Nehalem", "Sandybridge", "Haswell", "Zen")  # an x86-64 may lack the last


@pytest.fixture(scope="module")
def without_loops(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package as it is where there was no compiler."""
    folder = tmp_path_factory.mktemp("plain")
    ignored = shutil.ignore_patterns("*.so", "__pycache__")
    shutil.copytree(ROOT / "hframe_post", folder / "hframe_post", ignore=ignored)
    return folder


def converted(source: Path, package: Path, jobs: int = 1, seed: int = 0, blas: str = "") -> bytes:
    """The output of a process of its own."""
    env = {**os.environ, "PYTHONPATH": str(package), "PYTHONHASHSEED": str(seed)}
    if blas:
        env["OPENBLAS_CORETYPE"] = blas
    command = [sys.executable, "-m", "hframe_post", str(source), "-q", "-o", "-"]
    done = subprocess.run(
        [*command, "--jobs", str(jobs)], cwd=package, env=env, capture_output=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")
    return done.stdout


def test_neither_processes_nor_hashes_nor_compiled_loops_show(
    tmp_path: Path, without_loops: Path
) -> None:
    source = tmp_path / "part.gcode"
    source.write_bytes(SPANS)
    plain = converted(source, ROOT)
    assert converted(source, without_loops, jobs=2, seed=1, blas="Nehalem") == plain


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cube.gcode", "rectangle.gcode"])
def test_every_process_writes_the_same(without_loops: Path, name: str) -> None:
    source = SAMPLES / name
    plain = converted(source, ROOT)
    for jobs, seed in product((1, 2, 4), (0, 1, 4294967295)):
        assert converted(source, ROOT, jobs, seed) == plain, (jobs, seed)
    for package, blas in product((ROOT, without_loops), KERNELS):
        assert converted(source, package, blas=blas) == plain, (package, blas)
