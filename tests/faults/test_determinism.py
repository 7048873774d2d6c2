"""Equal input gives equal bytes: whatever the processes, hash seeds, BLAS kernels, processors."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import SAMPLES
from tests.gcode_tools import strokes

OLD_PROCESSOR = {
    "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable",
}
pytestmark = pytest.mark.slow


def convert(
    source: Path, output: Path, environment: Mapping[str, str] = {}, jobs: int = 1
) -> bytes:
    """Convert in a process of its own; return the output."""
    command = [sys.executable, "-m", "hframe_post", source, "-o", output, "-q", "-p", "paper"]
    subprocess.run(
        [*map(str, command), "--force", "--jobs", str(jobs)], check=True,
        env={**os.environ, "PYTHONHASHSEED": "0", **environment},
    )  # fmt: skip
    return output.read_bytes()


def test_every_process_writes_the_same(tmp_path: Path) -> None:
    source, output = SAMPLES / "cube.gcode", tmp_path / "out.gcode"
    plain = convert(source, output)
    assert convert(source, output, {"PYTHONHASHSEED": "4294967295"}, jobs=2) == plain
    assert convert(source, output, {"OPENBLAS_CORETYPE": "Haswell"}) == plain
    assert convert(source, output, OLD_PROCESSOR) == plain


def test_samples_are_equal_to_the_last_bit(tmp_path: Path) -> None:
    source, output = tmp_path / "strokes.gcode", tmp_path / "samples.npz"
    source.write_text("\n".join([*strokes(0, 6, 0.4), "G4 P1200", "G1 X60 Y60 E1", ""]))
    results = []
    for environment in ({}, OLD_PROCESSOR):
        convert(source, output, environment)
        with np.load(output) as samples:
            results.append({key: samples[key].tobytes() for key in samples.files})
    assert results[0] == results[1]
