"""A browser for the pages' tests."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.chromium import PROGRAM, Browser


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if PROGRAM is None:
        pytest.skip("chromium is not installed: make programs")
    with Browser(tmp_path_factory.mktemp("chromium")) as running:
        yield running


@pytest.fixture
def artefacts(tmp_path: Path) -> Path:
    """Where screenshots are kept: the folder named by ARTEFACTS, else with the test's own files."""
    folder = Path(os.environ.get("ARTEFACTS", tmp_path)).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    return folder
