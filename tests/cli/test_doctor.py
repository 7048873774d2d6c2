"""``doctor`` with and without problems."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from hframe_post.cli.main import main
from tests.command_line import run
from tests.printers import REAL

MAINSAIL = """\
[virtual_sdcard]
path: .
[pause_resume]
[gcode_macro CANCEL_PRINT]
rename_existing: CANCEL_PRINT_BASE
gcode:
    TURN_OFF_HEATERS
    CANCEL_PRINT_BASE
"""
SAVED = """
#*# <---------------------- SAVE_CONFIG ---------------------->
#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.
#*#
#*# [extruder]
#*# pid_kp = 22.2
"""
INCLUDE = "[include hframe.cfg]\n"


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with printer.cfg and what `setup` wrote for it."""
    folder = tmp_path_factory.mktemp("machine")
    (folder / "mainsail.cfg").write_text(MAINSAIL)
    config = folder / "printer.cfg"
    config.write_text(f"[include mainsail.cfg]\n{REAL.read_text()}\n{INCLUDE}{SAVED}")
    made = run("setup", config, "-o", folder, XDG_CONFIG_HOME=str(folder / "config"))
    assert made.returncode == 0, made.stderr
    return folder


def findings(folder: Path) -> tuple[int, str]:
    profile, config = str(folder / "printer.toml"), str(folder / "printer.cfg")
    environment = {"XDG_CONFIG_HOME": str(folder / "config"), "HFRAME_PRINTER": None}
    command = ["doctor", "-p", profile, "--printer-cfg", config]
    done = CliRunner().invoke(main, command, env=environment)
    assert not done.stderr
    return done.exit_code, done.stdout


def test_doctor_finds_no_problem_after_setup(machine: Path) -> None:
    status, printed = findings(machine)
    assert status == 0, printed
    assert "no problems found" in printed
    assert "PROBLEM" not in printed


OWN_MACRO = "[gcode_macro Cancel_PRINT]\ngcode:\n    M117\n    CANCEL_PRINT_BASE\n"


@pytest.mark.parametrize(
    ("file", "old", "new", "found"),
    [
        ("printer.cfg", SAVED, f"{SAVED}\n[fan]\n", "all that SAVE_CONFIG saved"),
        ("printer.cfg", INCLUDE + SAVED, SAVED + INCLUDE, "all that SAVE_CONFIG saved"),
        ("printer.cfg", INCLUDE, "", "hframe.cfg is not included"),
        ("printer.cfg", INCLUDE, INCLUDE + OWN_MACRO, "comes later"),
        ("hframe.cfg", "ACCEL=", "ACCEL=9", "hframe.cfg is not what this profile gives"),
        ("printer.cfg", "max_accel: 10000", "max_accel: 3000",
         "firmware.klipper.acceleration: 3000 (max_accel of [printer]), but the profile has 10000"),
        ("printer.cfg", "[input_shaper]", "[input_shaper]\nshaper_freq_z: 40",
         "shaper_freq_z: 40 (shaper_freq_z of [input_shaper]), but the profile has 0"),
        ("config/hframe-post/config.toml", "printer.toml", "other.toml", "does not exist any more"),
    ],
)  # fmt: skip
def test_doctor_finds_each_harm(machine: Path, file: str, old: str, new: str, found: str) -> None:
    path = machine / file
    before = path.read_text()
    assert old in before
    path.write_text(before.replace(old, new, 1))
    status, printed = findings(machine)
    path.write_text(before)
    lines = [line for line in printed.splitlines() if found.replace("@", str(machine)) in line]
    assert len(lines) == 1, printed
    assert lines[0].startswith("PROBLEM")
    assert status == (1 if "PROBLEM" in printed else 0)


def test_a_marlin_owner_is_told_of_no_printer_cfg(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text('extends = "example-ender"\n')
    done = run("doctor", "-p", own, HFRAME_PRINTER=str(own))
    assert done.returncode == 0
    assert done.stdout.endswith(b"no problems found, but m503.txt was not checked\n")
    shipped = run("doctor", "-p", "example-ender", HFRAME_PRINTER="")
    assert b"run 'hframe-post setup m503.txt'" in shipped.stdout
    assert b"printer.cfg" not in done.stdout + shipped.stdout
    own.write_text('extends = "paper-marlin"\n[plant]\ninvented = false\n')
    printed = run("measure", "--for", "check", "-p", own, "-o", tmp_path / "a.gcode")
    assert printed.returncode == 1
    assert b"measure again: 'hframe-post measure'" in printed.stderr
    converted = run("sample_gcode/rectangle.gcode", "-n", "-p", own)
    assert b"next             print it, and the file as sliced, and compare\n" in converted.stderr
