"""Every command with a firmware that is none of those in the package."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from hframe_post.cli.main import main
from hframe_post.identification.recordings.formats import read_command
from tests.command_line import RECTANGLE
from tests.firmware.stub import add, remove

PROFILE = """\
extends = "paper"
[firmware]
dialect = "stub"
[firmware.stub]
acceleration = 3000.0
[plant]
invented = false
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return a folder with a profile for the stub, its configuration and a converted file."""
    made = tmp_path_factory.mktemp("stub")
    (made / "own.toml").write_text(PROFILE)
    (made / "stub.txt").write_text("3000")
    add()
    done = command(made, "convert {print} -o {folder}/out.gcode --report {folder}/page.html")
    assert done.exit_code == 0, done.output
    yield made
    remove()


def command(folder: Path, line: str) -> Result:
    """Run a command in this process, which knows the stub."""
    words = [word.format(print=RECTANGLE, folder=folder) for word in line.split()]
    own = {"HFRAME_PRINTER": str(folder / "own.toml"), "XDG_CONFIG_HOME": str(folder / "config")}
    return CliRunner(env=own).invoke(main, words)


FAST = [
    "measure -o {folder}/sweep.gcode",
    "doctor",
    "setup {folder}/stub.txt -o {folder}/new --bed 220,200",
]
SLOW = [
    "simulate {print}",
    "simulate {print} --shapers",
    "calibrate-print --heat 210,60 -o {folder}/tower.gcode",
    "calibrate-print --compare 6% --heat 210,60 -o {folder}/squares.gcode",
    "convert {print} -o {folder}/fast.gcode --max-error 100um",
    "connect octoprint --folder {folder}",
]


@pytest.mark.parametrize(
    "line",
    [*FAST, *(pytest.param(line, marks=pytest.mark.slow) for line in SLOW)],
    ids=lambda line: " ".join(word for word in line.split() if "{" not in word),
)
def test_every_command_takes_the_firmware(folder: Path, line: str) -> None:
    done = command(folder, line)
    assert done.exit_code == 0, done.output
    assert "bug" not in done.output


@pytest.mark.parametrize("line", [
    "measure --for check -o {folder}/c.gcode", "connect klipper",
])  # fmt: skip
def test_what_is_for_another_firmware_says_so(folder: Path, line: str) -> None:
    done = command(folder, line)
    assert done.exit_code == 1
    assert "stub" in done.output
    assert "bug" not in done.output


def test_output_has_its_lines_and_the_page_its_shaper(folder: Path) -> None:
    text = (folder / "out.gcode").read_bytes()
    assert b"\nM204 S100000\n" in text
    assert b"\nM204 S3000\n" in text
    assert b"best input shaper" in (folder / "page.html").read_bytes()


def test_moves_of_a_sweep_are_those_of_its_command(folder: Path) -> None:
    assert command(folder, "measure -o {folder}/moves.gcode").exit_code == 0
    for moves in folder.glob("moves.*.gcode"):
        places = [line for line in moves.read_text().splitlines() if line.startswith("G1 X")]
        x = read_command(moves.with_suffix(".csv"))[:, 0]
        assert abs(float(places[-1].split()[1][1:]) - x[-1]) < 1e-3, "mm"
