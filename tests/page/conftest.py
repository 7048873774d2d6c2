"""A browser for the pages' tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.chromium import PROGRAM, Browser


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if PROGRAM is None:
        pytest.skip("chromium is not installed")
    with Browser(tmp_path_factory.mktemp("chromium")) as running:
        yield running
