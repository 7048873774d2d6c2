"""Speed, as ratios to yardsticks of the same run; shown, never asserted in seconds.

make bench
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.options import Options
from hframe_post.conversion.report import Report
from hframe_post.printer.settings import Printer
from hframe_post.stream.running import one_blas_thread
from tests.benchmarks.models import SPREAD, models
from tests.benchmarks.timing import fastest, processor_and_wall, seconds
from tests.conftest import SAMPLES

OPTIONS = Options("racking", ("none", "racking"))
IDENTIFIED = Path(__file__).parents[1] / "bytes/corexy.toml"  # as identify writes a CoreXY
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


@pytest.mark.parametrize("profile", [str(IDENTIFIED), "paper"], ids=["identified", "paper"])
@pytest.mark.parametrize("name", ["figure", "knot", "gyroid", "vase"])
def test_conversion_against_slicing(
    benchmark: BenchmarkFixture, tmp_path: Path, name: str, profile: str
) -> None:
    """Processor time and duration of CuraEngine, and of converting what it slices."""
    if shutil.which("CuraEngine") is None or not CURA.exists():
        pytest.skip("CuraEngine and its definitions are not here (apt install cura)")
    model, sliced, out = (tmp_path / f"{name}.{end}" for end in ("stl", "gcode", "out.gcode"))
    surface, settings = models()[name]
    model.write_bytes(surface)
    slicing = ["CuraEngine", "slice", "-j", str(CURA / "fdmprinter.def.json")]
    slicing += [w for item in (SPREAD | settings).items() for w in ("-s", "=".join(item))]
    runs = {"slicing": processor_and_wall(*slicing, "-l", str(model), "-o", str(sliced))}
    for jobs in ("1", "2"):
        runs[f"jobs {jobs}"] = processor_and_wall(
            *command(sliced, out, "-p", profile, "--force", "--jobs", jobs)
        )
    benchmark.pedantic(lambda: None, rounds=1)  # type: ignore[no-untyped-call]
    for run, (processor, wall) in runs.items():
        benchmark.extra_info |= {f"{run}, CPU s": processor, f"{run}, s": wall}
    benchmark.extra_info["times CuraEngine, CPU"] = runs["jobs 2"][0] / runs["slicing"][0]


def test_start_against_numpy(benchmark: BenchmarkFixture) -> None:
    version = [sys.executable, "-m", "hframe_post", "--version"]
    quiet = {"check": True, "capture_output": True}
    benchmark.pedantic(  # type: ignore[no-untyped-call]
        subprocess.run, args=(version,), kwargs=quiet, rounds=5
    )
    numpy = seconds(sys.executable, "-c", "import numpy")
    benchmark.extra_info["ratio to import numpy"] = fastest(benchmark) / numpy
    assert fastest(benchmark) <= 3.0 * numpy
