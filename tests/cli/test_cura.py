"""The script for Cura, loaded and run as by Cura's PostProcessingPlugin, on Cura's text."""

import importlib.util
import json
import re
import sys
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from hframe_post.cli.connect import script
from tests.command_line import run
from tests.conftest import ROOT, SAMPLES

LAYERS = 3
PROGRAM = f'"{sys.executable}" -m hframe_post'


class Script:
    """The base class in Cura: reads a script's settings from its JSON."""

    def __init__(self) -> None:
        self.own: dict[str, str] = {}

    def getSettingData(self) -> dict[str, Any]:
        data: dict[str, Any] = json.loads(self.getSettingDataString())
        return data

    def getSettingDataString(self) -> str:
        raise NotImplementedError

    def getSettingValueByKey(self, key: str) -> str:
        default: str = self.getSettingData()["settings"][key]["default_value"]
        return self.own.get(key, default)


class Message:
    """Cura's window."""

    shown: list[str]

    def __init__(self, text: str, title: str, lifetime: int) -> None:
        assert lifetime == 0  # stays
        self.text = text

    def show(self) -> None:
        Message.shown.append(self.text)


class Logger:
    @staticmethod
    def log(kind: str, text: str, *more: object) -> None:
        assert kind == "e"


@pytest.fixture
def cura(monkeypatch: pytest.MonkeyPatch) -> type[Script]:
    """Provide modules under Cura's names, and environment variables of another Python."""
    Message.shown = []
    modules: dict[str, dict[str, Any]] = {
        "PostProcessingPlugin": {},
        "PostProcessingPlugin.Script": {"Script": Script},
        "PostProcessingPlugin.PostProcessingPlugin": {},
        "UM": {},
        "UM.Logger": {"Logger": Logger},
        "UM.Message": {"Message": Message},
    }
    for name, members in modules.items():
        module = ModuleType(name)
        module.__dict__.update(members, __path__=[])
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setenv("PYTHONHOME", "/opt/cura/python")
    monkeypatch.setenv("LD_LIBRARY_PATH", "/opt/cura/lib")
    return Script


def loaded(path: Path) -> Any:
    """Return an instance of the class, found by the file's name as in Cura."""
    name = path.stem
    spec = importlib.util.spec_from_file_location(
        "PostProcessingPlugin.PostProcessingPlugin." + name, path
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return getattr(module, name)()


@pytest.fixture
def own(cura: type[Script], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    path = tmp_path / "HframePost.py"
    path.write_text(script(PROGRAM, str(ROOT / "tests" / "measured.toml")))
    monkeypatch.chdir(ROOT)  # where python -m finds this tree, since PYTHONPATH does not reach it
    return loaded(path)


@pytest.fixture
def data() -> list[str]:
    """Return Cura's list of texts: header, start code, layers, end code."""
    text = (SAMPLES / "cube.gcode").read_text()
    header, rest = text.split("\n;LAYER:0", 1)
    layers = re.split(r"(?m)^(?=;LAYER:)", ";LAYER:0" + rest)[1:]
    start = header.index("\n\n") + 1 if "\n\n" in header else header.index(";Generated")
    end = ";TIME_ELAPSED:9\nM104 S0\nM84 X Y E ;Disable\n;End of Gcode\n"
    return [header[:start], header[start:] + "\n", *layers[:LAYERS], end]


def test_layers_stay_apart_and_are_compensated(own: Any, data: list[str]) -> None:
    before = list(data)
    after = own.execute(data)
    assert Message.shown == []
    assert len(after) == len(before)
    assert "; processed by hframe-post" in "".join(after)
    for k in range(2, 2 + LAYERS):
        assert after[k].startswith(f";LAYER:{k - 2}\n")
        assert len(after[k]) > 3 * len(before[k])
    assert after[-1].endswith(before[-1].partition("\n")[2].partition("\n")[2])
    assert "HFRAME_POST_PART" not in "".join(after)


def test_a_failure_is_shown_and_the_file_is_marked(own: Any, data: list[str]) -> None:
    own.own = {"profile": "nobody.toml"}
    after = own.execute(list(data))
    assert "NOT compensated" in Message.shown[0]
    assert "no such profile or file" in Message.shown[0]
    assert after[1:] == data[1:]
    head, mark = after[0].rstrip("\n").rsplit("\n", 1)
    assert head + "\n" == data[0]
    assert mark.startswith(";NOT COMPENSATED: hframe-post failed: Error: nobody.toml")


def test_it_is_installed_into_every_version(cura: object, tmp_path: Path) -> None:
    install = partial(run, "connect", "cura", XDG_DATA_HOME=str(tmp_path), HOME=str(tmp_path))
    assert install().returncode == 1
    for version in ("4.13", "5.10", "5.10/scripts", "stored_files"):
        (tmp_path / "cura" / version).mkdir(parents=True)
    flatpak = tmp_path / ".var/app/com.ultimaker.cura/data/cura/5.9"
    flatpak.mkdir(parents=True)
    done = install("-p", "paper-strong")
    assert done.returncode == 0, done.stderr
    files = sorted(tmp_path.rglob("HframePost.py"))
    assert len(files) == 3
    assert str(files[0]) in done.stdout.decode()
    found = loaded(files[-1])
    assert found.getSettingData()["key"] == "HframePost"
    assert found.getSettingValueByKey("profile") == "paper-strong"
    assert install("-p", "nobody").returncode == 1
