"""Speed of step files, as ratios to gzip of the same rows in the same run.

make bench
"""

from __future__ import annotations

import gzip
import time
from collections.abc import Callable

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import SampleStream
from hframe_post.model.strategies import Compensator
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Samples
from hframe_post.writers.step_file import Header, StepFileWriter
from hframe_post.writers.steps import StepGenerator
from tests.benchmarks.timing import fastest
from tests.conftest import SAMPLES

GZIPPED = 10_000_000  # bytes, as many as the yardstick needs to be steady


@pytest.fixture(scope="module")
def prism(paper: Printer, compensator: Compensator) -> list[Samples]:
    """The commands of half an hour of print."""
    blocks: list[Samples] = []
    with (SAMPLES / "prism.gcode").open("rb") as lines:
        commands = SampleStream(lines, paper, Options("racking"), compensator=compensator)
        for block in commands.computed():
            blocks.append(block)
            if block.end > 1_800_000:
                break
    return blocks


def writing(prism: list[Samples], paper: Printer) -> Callable[[], tuple[bytes, StepFileWriter]]:
    table = paper.steps
    assert table is not None
    lengths = (table.belt, table.belt, table.z, table.e)
    header = Header("", "", "", table.clock_hz, lengths, paper.kinematics.matrix)

    def run() -> tuple[bytes, StepFileWriter]:
        stepper, writer = StepGenerator("racking", paper.kinematics, table), StepFileWriter(header)
        pieces = writer.write(stepper.step(prism))
        return b"".join(piece for piece in pieces if isinstance(piece, bytes)), writer

    return run


def gzip_speed(text: bytes) -> float:
    """Bytes a second of gzip -9."""
    some = text[:GZIPPED]
    start = time.perf_counter()
    gzip.compress(some, 9)
    return len(some) / (time.perf_counter() - start)


def test_writing_against_gzip(
    benchmark: BenchmarkFixture, prism: list[Samples], paper: Printer
) -> None:
    """From samples to text, steps and all."""
    text, lines = benchmark.pedantic(  # type: ignore[no-untyped-call]
        writing(prism, paper), rounds=3, warmup_rounds=1
    )
    seconds = fastest(benchmark)
    ratio = len(text) / seconds / gzip_speed(text)
    benchmark.extra_info["million rows a second"] = lines.rows / seconds / 1e6
    benchmark.extra_info["MB a second"] = len(text) / seconds / 1e6
    benchmark.extra_info["times as fast as gzip -9"] = ratio
    assert ratio > 1.0
