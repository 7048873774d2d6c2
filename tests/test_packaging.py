"""The wheel holds everything the tool needs, and its sources."""

import os
import re
import subprocess
import sys
import tomllib
import venv
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

import hframe_post
from tests.conftest import ROOT, SAMPLES
from tools.release_check import missing

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


@pytest.fixture
def wheel(tmp_path: Path) -> Path:
    """Build the wheel from the source distribution, which must be complete for that."""
    build = [sys.executable, "-W", "error", "-m", "build", "-q", "--outdir", str(tmp_path)]
    same = {**os.environ, "SETUPTOOLS_SCM_PRETEND_VERSION": hframe_post.__version__}
    subprocess.run([*build, str(ROOT)], check=True, env=same)
    assert len(list(tmp_path.glob("*.tar.gz"))) == 1
    (found,) = tmp_path.glob("*.whl")
    return found


@pytest.mark.slow
def test_the_wheel_converts_the_sample_in_an_empty_environment(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as packed:
        names = {name for name in packed.namelist() if name.startswith("hframe_post/")}
    source = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "hframe_post").rglob("*")
        if path.is_file() and not path.match("*.pyc") and not path.match("_hframe_live-*.so")
    }
    built = {name for name in names | source if "/_kernels." in name}
    assert names - built == source - built
    assert names & built
    assert "-cp311-abi3-" in wheel.name
    venv.create(tmp_path / "venv", with_pip=True)
    programs = tmp_path / "venv" / "bin"
    environ = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run([programs / "pip", "install", "-q", wheel], check=True, env=environ)
    converts(programs / "hframe-post", tmp_path)
    text = subprocess.run([programs / "hframe-post", "doctor"], check=True, env=environ,
                          capture_output=True, text=True, cwd=tmp_path).stdout  # fmt: skip
    assert f"installed in {tmp_path}" in text
    assert "no problems found" in text


def converts(program: Path, folder: Path) -> None:
    """Check that the program writes the same as this tree, in several processes and in a batch."""
    environ = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    cube, rectangle = SAMPLES / "cube.gcode", SAMPLES / "rectangle.gcode"
    whole: list[str | Path] = [program, cube, "-q", "-o", folder / "cube.gcode", "--jobs", "2"]
    subprocess.run(whole, check=True, env=environ, cwd=folder)
    here = [sys.executable, "-m", "hframe_post", str(cube), "-q", "-o", str(folder / "here.gcode")]
    subprocess.run(here, check=True)
    assert (folder / "cube.gcode").read_bytes() == (folder / "here.gcode").read_bytes()
    batch: list[str | Path] = [program, "batch", rectangle, "-q", "-o", folder / "out"]
    subprocess.run(batch, check=True, env=environ, cwd=folder)
    assert b"; processed by hframe-post" in (folder / "out" / rectangle.name).read_bytes()


IMPORT = re.compile(r"^ *(?:from (\w+)[\w.]* import |import (\w+)[\w.]*(?: as \w+)?$)", re.M)


def test_every_import_is_a_dependency_or_an_extra() -> None:
    texts = [path.read_text("utf-8") for path in (ROOT / "hframe_post").rglob("*.py")]
    imported = {found[1] or found[2] for text in texts for found in IMPORT.finditer(text)}
    imported -= {*sys.stdlib_module_names, "hframe_post", "cffi"}  # which Klipper has
    project = PROJECT["project"]
    needed = {re.split(r"[><=]", line)[0] for line in project["dependencies"]}
    extras = {
        re.split(r"[><=]", line)[0]
        for name, lines in project["optional-dependencies"].items()
        if name != "dev"
        for line in lines
    }
    assert imported <= needed | extras


def test_octoprint_finds_the_plugin_in_the_package() -> None:
    (found,) = {each.value for each in metadata.entry_points(group="octoprint.plugin")}
    place = ROOT / found.replace(".", "/")
    assert "__plugin_implementation__" in (place / "__init__.py").read_text("utf-8")


def test_version_is_that_of_the_installation() -> None:
    assert metadata.version("hframe-post") == hframe_post.__version__


FILLED_IN = {
    "pyproject.toml": "[project.urls]\nHomepage = ''\nRepository = ''\nChangelog = ''\n",
    "README.md": "![a figure](https://example.org/a.svg)\npipx install hframe-post\n",
    "docs/start.md": "pipx install hframe-post\n",
}


@pytest.mark.parametrize(
    ("page", "now", "forgotten", "words"),
    [
        ("pyproject.toml", "Homepage", "Home", r": \[project.urls\] has no Homepage"),
        ("README.md", "https://example.org/", "docs/", ":1: PyPI shows figures"),
        ("docs/start.md", "install hframe-post", "install .", ":1: .*: pipx install \\."),
        ("docs/start.md", "pipx", "It is in no index", ":1: .*: It is in no index"),
    ],
)
def test_a_release_names_what_its_owner_forgot(
    page: str, now: str, forgotten: str, words: str, tmp_path: Path
) -> None:
    for name, text in FILLED_IN.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert missing(tmp_path) == []
    (tmp_path / page).write_text(FILLED_IN[page].replace(now, forgotten))
    (line,) = missing(tmp_path)
    assert re.match(f"{page}{words}", line)
