"""The same bytes on every processor."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.gcode_tools import strokes

OLD_PROCESSOR = {
    "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable",
}
MACHINES = {
    "here": {},
    "old": OLD_PROCESSOR,
    "Sandybridge": {"OPENBLAS_CORETYPE": "Sandybridge"},
    "Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
}
CPUINFO = Path("/proc/cpuinfo")
if CPUINFO.exists() and "avx512f" in CPUINFO.read_text():  # others do not know its instructions
    MACHINES["SkylakeX"] = {"OPENBLAS_CORETYPE": "SkylakeX"}


def convert(source: Path, output: Path, environment: dict[str, str]) -> None:
    command = [sys.executable, "-m", "hframe_post", source, "-o", output, "-q", "--force"]
    command += ["-p", "paper"]
    subprocess.run(list(map(str, command)), check=True, env={**os.environ, **environment})


@pytest.mark.slow
def test_samples_are_equal_to_the_last_bit(tmp_path: Path) -> None:
    source, results = tmp_path / "strokes.gcode", []
    source.write_text("\n".join([*strokes(0, 6, 0.4), "G4 P1200", "G1 X60 Y60 E1", ""]))
    for name in ("here", "old"):
        convert(source, tmp_path / f"{name}.npz", MACHINES[name])
        with np.load(tmp_path / f"{name}.npz") as samples:
            results.append({key: samples[key].tobytes() for key in samples.files})
    assert results[0] == results[1]
