"""The compiled loops, built from the sources in the tree without Python's own headers."""

import importlib.util
import shutil
import subprocess
import sysconfig
from pathlib import Path
from types import ModuleType

import pytest

import hframe_post

SOURCES = Path(hframe_post.__file__).parent / "native"


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    compiler = shutil.which((sysconfig.get_config_var("CC") or "cc").split()[0])
    if compiler is None:
        pytest.skip("no C compiler here")
    path = tmp_path_factory.mktemp("compiled") / "_kernels.so"
    flags = "-std=c99 -Wall -Wextra -Werror -O3 -ffp-contract=off -fPIC -DPy_LIMITED_API=0x030B0000"
    sources = sorted(map(str, SOURCES.glob("*.c")))
    subprocess.run([compiler, *flags.split(), "-shared", "-o", path, *sources, "-lm"], check=True)
    spec = importlib.util.spec_from_file_location("hframe_post.native._kernels", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
