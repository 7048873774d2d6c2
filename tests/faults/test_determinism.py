"""Equal input gives equal bytes, in whatever process: jobs, hash seeds, loops.

BLAS kernels of another processor round differently, which may move where a segment ends.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hframe_post.testing import assert_same_motion
from tests.conftest import ROOT, SAMPLES
from tests.gcode_tools import SPANS

KERNELS = ("Prescott", "Nehalem", "Sandybridge", "Haswell")  # that any machine of ten years runs
APART = 0.015  # mm between two paths that decimation may take for one


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


@pytest.mark.slow
def test_neither_processes_nor_hashes_nor_compiled_loops_show(
    tmp_path: Path, without_loops: Path
) -> None:
    source = tmp_path / "part.gcode"
    source.write_bytes(SPANS)
    plain = converted(source, ROOT)
    assert converted(source, without_loops, jobs=2, seed=1) == plain


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cube.gcode", "rectangle.gcode"])
def test_every_process_writes_the_same(without_loops: Path, name: str) -> None:
    source = SAMPLES / name
    plain = converted(source, ROOT)
    for jobs, seed in ((1, 4294967295), (2, 1), (4, 0)):
        assert converted(source, ROOT, jobs, seed) == plain, (jobs, seed)
    assert converted(source, without_loops) == plain
    for blas in KERNELS:
        other = converted(source, ROOT, blas=blas)
        assert converted(source, without_loops, blas=blas) == other, blas
        assert_same_motion(plain, other, tolerance=APART, slack=3e-3)
