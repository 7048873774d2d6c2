"""What installed packages add by entry points: shapers, kinematics, firmwares."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hframe_post.errors import HframeError, PrinterError
from hframe_post.firmware.registry import firmware
from hframe_post.model.shapers import compared, shaper
from hframe_post.printer.profile import load
from tests.command_line import RECTANGLE, run

CODE = """\
from hframe_post.model.kinematics import Belts
from hframe_post.model.shapers import Kind

THIRDS = Kind(lambda damping: ([1.0, 1.0, 1.0], [0.0, 1.0 / 3.0, 2.0 / 3.0]))
TBOT = Belts(((1.0, 1.0), (-1.0, 1.0)), racks=True)
"""
Install = Callable[..., Path]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Return a function that installs a package of that name, code and entry points."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def done(name: str, code: str, **points: str) -> Path:
        info = tmp_path / f"{name}-2.5.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 2.5\n")
        groups = (f"[hframe_post.{group}]\n{row}\n" for group, row in points.items())
        (info / "entry_points.txt").write_text("".join(groups))
        (tmp_path / f"{name}.py").write_text(code)
        return tmp_path

    return done


def profile(folder: Path, text: str) -> str:
    path = folder / "own.toml"
    path.write_text(f'extends = "paper"\n{text}')
    return str(path)


def test_a_shaper_of_a_package_is_one_of_those_compared(install: Install) -> None:
    assert "thirds" not in compared()
    install("own_shaper", CODE, shapers="thirds = own_shaper:THIRDS")
    assert "thirds" in compared()
    made = shaper("thirds", 50.0, 0.0)
    assert made.A.tolist() == pytest.approx([1 / 3, 1 / 3, 1 / 3])
    assert made.T.tolist() == pytest.approx([-1 / 150, 0.0, 1 / 150])


def test_kinematics_of_a_package_are_those_of_a_profile(install: Install) -> None:
    folder = install("own_kinematics", CODE, kinematics="tbot = own_kinematics:TBOT")
    kinematics = load(profile(folder, '[kinematics]\ntype = "tbot"\n')).kinematics
    assert kinematics.matrix.tolist() == [[1.0, 1.0], [-1.0, 1.0]]
    assert (kinematics.racks, kinematics.bed_moves, kinematics.z_is_separate) == (True, False, True)
    with pytest.raises(PrinterError, match=r"kinematics\.type: must be one of .*cartesian, tbot$"):
        load(profile(folder, '[kinematics]\ntype = "delta"\n'))


def test_a_firmware_of_a_package_plays_a_profile(install: Install) -> None:
    code = "from tests.firmware.stub import STUB"
    folder = install("own_firmware", code, firmwares="stub = own_firmware:STUB")
    text = '[firmware]\ndialect = "stub"\n[firmware.stub]\nacceleration = 3000.0\n'
    assert firmware(load(profile(folder, text))).configuration == "stub.txt"
    with pytest.raises(PrinterError, match="unknown key; nearest known is 'stub'"):
        load(profile(folder, "[firmware.stup]\nacceleration = 3000.0\n"))


@pytest.mark.parametrize(
    ("name", "code", "words"),
    [
        ("cut_off", "THIRDS = (", r"cannot be loaded: SyntaxError: .*\. Update it, or uninstall"),
        ("too_old", "import no_such_module", "cannot be loaded: ModuleNotFoundError: No module"),
        ("empty", "", "cannot be loaded: AttributeError: .* no attribute 'THIRDS'"),
        ("other", "THIRDS = 3", r"offers another object: other:THIRDS\. Update it"),
    ],
)
def test_a_broken_package_is_named(install: Install, name: str, code: str, words: str) -> None:
    install(name, code, shapers=f"{name} = {name}:THIRDS")
    whose = f"{name} 2.5, which adds '{name}' to the shapers of hframe-post, "
    with pytest.raises(HframeError, match=f"^{whose}{words}"):
        shaper(name, 50.0, 0.1)


def test_two_packages_of_one_name_are_both_named(install: Install) -> None:
    install("first", CODE, shapers="thirds = first:THIRDS")
    install("second", CODE, shapers="thirds = second:THIRDS")
    with pytest.raises(HframeError, match=r"(first|second) 2\.5 and .* 2\.5 both add 'thirds'"):
        compared()


def test_a_broken_firmware_is_one_line_on_the_command_line(install: Install) -> None:
    folder = install("broken", "1 / 0", firmwares="mine = broken:MINE")
    done = run(RECTANGLE, "-n", "-p", "paper", "--firmware", "mine", PYTHONPATH=str(folder))
    assert done.returncode == 1
    error = done.stderr.decode()
    assert error.startswith("Error: broken 2.5, which adds 'mine' to the firmwares of hframe-post")
    assert error.count("\n") == 1
