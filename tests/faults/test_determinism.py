"""Equal input gives equal bytes: whatever the processes, hash seeds, BLAS kernels, processors."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.conftest import SAMPLES

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
