"""Fixtures and settings of all tests: the paper's printer, its compensator, golden files."""

import os
import signal
import tempfile

# The configuration of whoever runs the tests must not matter.
os.environ["XDG_CONFIG_HOME"] = os.path.join(tempfile.gettempdir(), "hframe-post-tests")
os.environ["HFRAME_PRINTER"] = os.path.join(os.path.dirname(__file__), "measured.toml")

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import prepared
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.model.strategies import Compensator
from hframe_post.native.linear import one_blas_thread
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from hframe_post.stream.chunks import join
from hframe_post.stream.types import Samples
from tests.budgets import (  # noqa: F401
    pytest_runtest_logreport,
    pytest_runtest_makereport,
    pytest_runtest_protocol,
    pytest_terminal_summary,
)

settings.register_profile(
    "repeatable", max_examples=50, derandomize=True, deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)  # fmt: skip  # the same examples on each machine, however slow or busy it is
settings.load_profile("repeatable")

ROOT = Path(__file__).parent.parent
MEASURED = ROOT / "tests" / "measured.toml"
SAMPLES = ROOT / "sample_gcode"
GOLDEN = Path(__file__).parent / "golden"


def few(cases: Sequence[object], quick: int) -> list[object]:
    """Return the cases of a test, with all but the first ``quick`` marked slow."""
    whole = [case if isinstance(case, tuple) else (case,) for case in cases]
    slow = [pytest.param(*case, marks=pytest.mark.slow) for case in whole[quick:]]
    return [*cases[:quick], *slow]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update-golden", action="store_true", help="rewrite tests/golden")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files of this folder: they hold the longest tests.

    One that began last would leave the other processes without work.
    """
    items.sort(key=lambda item: item.path.parent != ROOT / "tests")


def pytest_configure() -> None:
    """Let the processes that tests start heed signals that this one was started to ignore.

    A shell starts background jobs with SIGINT ignored, and nohup its command with SIGHUP ignored.
    Child processes would inherit that. They get the default in place of any handler, even of one
    that does nothing.
    """
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT, signal.SIGTERM):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, lambda *_: None)


@pytest.fixture(scope="session", autouse=True)
def blas_in_one_thread() -> Iterator[None]:
    """Run BLAS in one thread, without which results may differ in their last bits."""
    with one_blas_thread():
        yield


@pytest.fixture(scope="session")
def paper() -> Printer:
    """Return the paper's printer, as if it had been measured here."""
    return replace(load("paper"), invented=False)


@pytest.fixture(scope="session")
def compensator(paper: Printer) -> Compensator:
    return prepared(paper)


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Callable[[str, bytes], bytes]:
    """Return a reader of golden files; with --update-golden it first writes ``now`` to them."""

    def read(name: str, now: bytes) -> bytes:
        path = GOLDEN / name
        if request.config.getoption("--update-golden"):
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(now)
        return path.read_bytes()

    return read


@pytest.fixture(scope="session")
def commands(paper: Printer) -> Callable[[str], Samples]:
    """Return a function that compensates the sample rectangle with a strategy, in one chunk."""

    def whole(strategy: str) -> Samples:
        lines = (SAMPLES / "rectangle.gcode").read_bytes().splitlines(keepends=True)
        commands = WholeFile(iter(lines), paper, Options(strategy)).samples()
        return join([chunk for chunk in commands if len(chunk)])

    return whole
