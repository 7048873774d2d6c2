"""The wheel holds all that the tool needs, and what it was built from."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import hframe_post
from tests.conftest import ROOT, SAMPLES

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


@pytest.mark.slow
def test_wheel_converts_the_sample(tmp_path: Path) -> None:
    """Unpacked elsewhere, beside the dependencies that are installed here."""
    build = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "-q",
        "--no-deps",
        "-w",
        str(tmp_path),
        str(ROOT),
    ]
    subprocess.run(build, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as packed:
        names = set(packed.namelist())
        packed.extractall(tmp_path / "site")
    source = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "hframe_post").rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    built = {name for name in names | source if "/_kernels." in name}
    assert {name for name in names if name.startswith("hframe_post/")} - built == source - built
    assert (names & built) or shutil.which("cc") is None
    assert "hframe_post/py.typed" in names
    target = tmp_path / "out.gcode"
    convert = [sys.executable, "-m", "hframe_post", str(SAMPLES / "rectangle.gcode")]
    subprocess.run(
        [*convert, "-q", "-o", str(target)],
        check=True, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(tmp_path / "site")},
    )  # fmt: skip
    assert target.stat().st_size > 0


IMPORTED_AS = {"pybgcode": "pybgcode-jneilliii"}


def test_every_import_is_a_dependency_or_an_extra() -> None:
    trees = [
        ast.walk(ast.parse(path.read_text("utf-8")))
        for path in (ROOT / "hframe_post").rglob("*.py")
    ]
    nodes = [node for tree in trees for node in tree]
    modules = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    modules += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    imported = {module.partition(".")[0] for module in modules}
    imported -= {*sys.stdlib_module_names, "hframe_post"}
    project = PROJECT["project"]
    needed = {re.split(r"[><=]", line)[0] for line in project["dependencies"]}
    extras = {
        re.split(r"[><=]", line)[0]
        for name, lines in project["optional-dependencies"].items()
        if name != "dev"
        for line in lines
    }
    imported = {IMPORTED_AS.get(name, name) for name in imported}
    assert imported <= needed | extras


def test_version_is_that_of_the_package() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+", hframe_post.__version__)
    assert PROJECT["tool"]["setuptools"]["dynamic"]["version"]["attr"].startswith("hframe_post.")
