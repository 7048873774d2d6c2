"""Speed, as ratios to yardsticks of the same run; shown, never asserted in seconds.

make bench
"""

from __future__ import annotations

import json
import os
import shutil
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.pipeline import Options
from hframe_post.conversion.report import Report
from hframe_post.printer.settings import Printer
from hframe_post.stream.running import one_blas_thread
from tests.benchmarks.timing import fastest, seconds
from tests.conftest import SAMPLES

OPTIONS = Options("racking", ("none", "racking"))
CURA = Path("/usr/share/cura/resources/definitions")


def command(source: Path, out: Path, *options: str) -> list[str]:
    return [sys.executable, "-m", "hframe_post", str(source), "-q", "-o", str(out), *options]


@pytest.mark.parametrize("name", ["cube.gcode", "prism.gcode"])
def test_conversion_against_gzip_and_real_time(
    benchmark: BenchmarkFixture, tmp_path: Path, name: str
) -> None:
    """The whole command, with prediction, on all processors."""
    out, report = tmp_path / "out.gcode", tmp_path / "report.json"
    convert = command(SAMPLES / name, out, "--json", str(report))
    benchmark.pedantic(  # type: ignore[no-untyped-call]
        subprocess.run, args=(convert,), kwargs={"check": True}, rounds=3
    )
    took, printed = fastest(benchmark), json.loads(report.read_text())
    gzip = seconds("gzip", "-9", "-k", "-c", str(SAMPLES / name))
    benchmark.extra_info["times gzip -9 of the input"] = took / gzip
    benchmark.extra_info["times as fast as the print"] = printed["print_time_s"]["after"] / took
    benchmark.extra_info["lines read a second"] = printed["lines_read"] / took


@pytest.mark.parametrize("jobs", [1, 2, 4])
def test_conversion_by_processes(benchmark: BenchmarkFixture, tmp_path: Path, jobs: int) -> None:
    """More than there are processors bring nothing."""
    convert = command(SAMPLES / "prism.gcode", tmp_path / "out.gcode", "--jobs", str(jobs))
    benchmark.pedantic(  # type: ignore[no-untyped-call]
        subprocess.run, args=(convert,), kwargs={"check": True}, rounds=1
    )
    benchmark.extra_info["processors"] = len(os.sched_getaffinity(0))


def converted(lines: list[bytes], printer: Printer) -> Report:
    with one_blas_thread():
        conversion = GcodeConversion(lines, printer, OPTIONS)
        for _ in conversion:
            pass
        return conversion.report()


@pytest.mark.parametrize("wider", [1, 2, 4])
def test_stages_by_width_of_the_window(
    benchmark: BenchmarkFixture, paper: Printer, wider: int
) -> None:
    """Processor time of each stage for an hour of print; that of solving grows with the window."""
    lines = (SAMPLES / "prism.gcode").read_bytes().splitlines(keepends=True)[:5000]
    compensation = replace(paper.compensation, n_C=paper.compensation.n_C * wider)
    printer = replace(paper, compensation=compensation)
    report = benchmark.pedantic(  # type: ignore[no-untyped-call]
        converted, args=(lines, printer), rounds=1
    )
    hours = report.time.after / 3600.0
    for stage, spent in report.seconds.items():
        benchmark.extra_info[f"{stage}, s an hour of print"] = spent / hours


def test_conversion_against_slicing(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    """A knot of many short moves: CuraEngine makes of it what is converted."""
    if shutil.which("CuraEngine") is None or not CURA.exists():
        pytest.skip("CuraEngine and its definitions are not here (apt install cura)")
    model, sliced = tmp_path / "knot.stl", tmp_path / "knot.gcode"
    model.write_bytes(knot())
    definition = str(CURA / "fdmprinter.def.json")
    settings = "center_object=true", "machine_width=220", "machine_depth=220"
    slicing = ["CuraEngine", "slice", "-j", definition]
    slicing += [part for setting in settings for part in ("-s", setting)]
    slicing += ["-l", str(model), "-o", str(sliced)]
    slicer = seconds(*slicing, rounds=1)
    convert = command(sliced, tmp_path / "out.gcode")
    benchmark.pedantic(  # type: ignore[no-untyped-call]
        subprocess.run, args=(convert,), kwargs={"check": True}, rounds=1
    )
    benchmark.extra_info["times CuraEngine"] = fastest(benchmark) / slicer


def knot(around: int = 1500, across: int = 60) -> bytes:
    """A torus knot as a tube of triangles: binary STL."""
    u = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    radius = 20.0 + 8.0 * np.cos(3.0 * u)
    centre = np.stack(
        [radius * np.cos(2.0 * u), radius * np.sin(2.0 * u), 8.0 * np.sin(3.0 * u) + 12.1], axis=1
    )
    ahead = np.roll(centre, -1, axis=0) - np.roll(centre, 1, axis=0)
    side = np.cross(ahead, [0.0, 0.0, 1.0])
    up = np.cross(ahead, side)
    v = np.linspace(0.0, 2.0 * np.pi, across, endpoint=False)[None, :, None]
    ring = [axis / np.linalg.norm(axis, axis=1)[:, None] for axis in (side, up)]
    a = centre[:, None] + 4.0 * (np.cos(v) * ring[0][:, None] + np.sin(v) * ring[1][:, None])
    b = np.roll(a, -1, axis=0)
    c, d = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    corners = np.concatenate([np.stack([a, c, b], axis=2), np.stack([b, c, d], axis=2)])
    facets = np.zeros(2 * around * across, dtype=[("n", "<f4", 3), ("v", "<f4", 9), ("a", "<u2")])
    facets["v"] = corners.reshape(-1, 9)
    return bytes(80) + struct.pack("<I", len(facets)) + facets.tobytes()


def test_start_against_numpy(benchmark: BenchmarkFixture) -> None:
    version = [sys.executable, "-m", "hframe_post", "--version"]
    quiet = {"check": True, "capture_output": True}
    benchmark.pedantic(  # type: ignore[no-untyped-call]
        subprocess.run, args=(version,), kwargs=quiet, rounds=5
    )
    numpy = seconds(sys.executable, "-c", "import numpy")
    benchmark.extra_info["ratio to import numpy"] = fastest(benchmark) / numpy
    assert fastest(benchmark) <= 3.0 * numpy
