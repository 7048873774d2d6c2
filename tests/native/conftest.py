"""The compiled loops, built from the sources in the tree."""

from __future__ import annotations

import shutil
import subprocess
import sysconfig
from pathlib import Path

import pytest

import hframe_post
from hframe_post import native

SOURCES = Path(hframe_post.__file__).parent / "native"


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> dict[str, native.Kernel]:
    compiler = shutil.which((sysconfig.get_config_var("CC") or "cc").split()[0])
    if compiler is None:
        pytest.skip("no C compiler here")
    path = tmp_path_factory.mktemp("compiled") / "kernels.so"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O3", "-ffp-contract=off", "-fPIC"]
    sources = sorted(map(str, SOURCES.glob("*.c")))
    subprocess.run([compiler, *flags, "-shared", "-o", path, *sources, "-lm"], check=True)
    found = native.loaded(path)
    assert found is not None
    return found


@pytest.fixture
def compiled(library: dict[str, native.Kernel], monkeypatch: pytest.MonkeyPatch) -> None:
    """Use the compiled version of every loop."""
    monkeypatch.setattr(native, "built", lambda: library)
