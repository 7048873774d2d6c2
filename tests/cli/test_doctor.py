"""``doctor`` with and without problems."""

from __future__ import annotations

import os
import shutil
import time
from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner

from hframe_post.cli.main import main
from hframe_post.firmware.klipper.version import is_affected
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


OLD_MACRO = "[gcode_macro CANCEL_PRINT]\ngcode:\n    _HFRAME_END\n    CANCEL_PRINT_BASE\n"


@pytest.mark.parametrize(
    ("file", "old", "new", "found"),
    [
        ("printer.cfg", SAVED, f"{SAVED}\n[fan]\n", "all that SAVE_CONFIG saved"),
        ("printer.cfg", INCLUDE + SAVED, SAVED + INCLUDE, "all that SAVE_CONFIG saved"),
        ("printer.cfg", INCLUDE, "", "hframe.cfg is not included"),
        ("printer.cfg", INCLUDE, INCLUDE + OLD_MACRO.replace("CANCEL", "Cancel"), "comes later"),
        ("printer.cfg", INCLUDE, INCLUDE + OLD_MACRO, "is of an older hframe-post and replaces"),
        ("printer.cfg", INCLUDE, INCLUDE + OLD_MACRO.replace("_HFRAME_END", "M117"),
         "replaces the [gcode_macro CANCEL_PRINT] of @/mainsail.cfg:6"),
        ("hframe.cfg", "ACCEL=", "ACCEL=9", "hframe.cfg is not what this profile gives"),
        ("printer.cfg", "max_accel: 10000", "max_accel: 3000",
         "[printer] max_accel: 3000, but firmware.klipper.acceleration = 10000"),
        ("printer.cfg", "[input_shaper]", "[input_shaper]\nshaper_freq_z: 40",
         "shaper_freq_z: 40, but firmware.klipper.shaper_freq_z = 0"),
        ("config/hframe-post/config.toml", "printer.toml", "other.toml", "does not exist any more"),
        ("config/PrusaSlicer/print/a.ini", "", "post_process = hframe-post -p o.toml",
         "takes o.toml"),
        ("config/PrusaSlicer/printer/a.ini", "", "printer_notes = a\\nHFRAME_PRINTER=/o.toml\\nb",
         "takes /o.toml, not"),
        ("config/OrcaSlicer/user/1/process/a.json", "",
         '{"post_process": ["\\"C:\\\\x\\\\hframe-post.exe\\" -p \\"my old.toml\\";"]}',
         "takes my old.toml, not"),
    ],
)  # fmt: skip
def test_doctor_finds_each_harm(machine: Path, file: str, old: str, new: str, found: str) -> None:
    path = machine / file
    before = path.read_text() if path.exists() else None
    path.parent.mkdir(parents=True, exist_ok=True)
    assert old in (before or "")
    path.write_text((before or "").replace(old, new, 1))
    status, printed = findings(machine)
    if before is None:
        path.unlink()
    else:
        path.write_text(before)
    lines = [line for line in printed.splitlines() if found.replace("@", str(machine)) in line]
    assert len(lines) == 1, printed
    chosen = "(setup: " in found or "replaces the [" in found
    assert lines[0].startswith("note" if chosen else "PROBLEM")
    assert status == (1 if "PROBLEM" in printed else 0)


LOGGED = "Git version: 'v0.13.0-99-g0123456ab'\n===== Config file =====\n"


@pytest.mark.parametrize(
    ("version", "affected"),
    [
        ("v0.13.0-630-ge4c4a5b94", False),  # the last before
        ("v0.13.0-631-gdb10e92e9", True),
        ("v0.13.0-641-g2239041df", True),
        ("v0.13.0-642-g77d5d942e", False),
        ("v0.12.0-635-g0123456ab", False),
        ("460ee783", True),  # of a shallow copy, which knows no release
        ("460ee783-dirty", True),
        ("77d5d942e", False),
        ("v2026.01.00-635-g0123456ab", False),  # of Kalico
        ("?", False),
    ],
)
def test_which_klipper_does_not_turn_shaping_off(version: str, affected: bool) -> None:
    assert is_affected(version) == affected


@pytest.mark.parametrize(
    ("version", "affected"),
    [("v0.13.0-635-g352bc8b2e-dirty", True), ("v0.13.0-642-g77d5d942e", False)],
)
def test_doctor_knows_the_klipper_that_does_not_turn_shaping_off(
    machine: Path, tmp_path: Path, version: str, affected: bool
) -> None:
    config = tmp_path / "printer_data" / "config"
    shutil.copytree(machine, config)
    cfg = config / "printer.cfg"
    cfg.write_text(cfg.read_text().replace("[input_shaper]", "[input_shaper]\nshaper_freq_x: 51.5"))
    own, home = config / "printer.toml", str(config / "config")
    run("setup", cfg, "-o", config, "--reset", XDG_CONFIG_HOME=home)
    doctor = partial(run, "doctor", "-p", own, "--printer-cfg", cfg, HFRAME_PRINTER=str(own))
    unknown = doctor()
    assert unknown.returncode == 0, unknown.stdout
    assert b"note     Klipper's version is not known: show its log with --klippy" in unknown.stdout
    log = config.parent / "logs" / "klippy.log"
    log.parent.mkdir()
    log.write_text(f"{LOGGED}Start\nGit version: '{version}'\nBranch: master\n\xff")
    done = doctor()
    assert done.returncode == affected, done.stdout
    text = f"PROBLEM  {log}: Klipper {version} ignores SET_INPUT_SHAPER SHAPER_FREQ_X=0"
    assert (text in done.stdout.decode()) == affected
    assert b"--klippy-log" not in done.stdout
    log.rename(tmp_path / "other.log")
    assert doctor("--klippy-log", tmp_path / "other.log").returncode == affected
    (tmp_path / "other.log").write_text("no version")
    assert (
        b"does not show Klipper's version" in doctor("--klippy-log", tmp_path / "other.log").stdout
    )
    cfg.write_text((machine / "printer.cfg").read_text())  # no frequency: nothing to turn off
    run("setup", cfg, "-o", config, "--reset", XDG_CONFIG_HOME=home)
    log.write_text(f"Git version: '{version}'\n")
    assert doctor().returncode == 0


def test_doctor_notes_an_old_model(machine: Path, tmp_path: Path) -> None:
    folder = tmp_path / "machine"
    shutil.copytree(machine, folder)
    profile = folder / "printer.toml"
    plant = ("[plant]", "invented = false", "Ts = 0.001", "Gxx = {gain=1.0, zeros=[], poles=[]}",
             "Gyy = {gain=1.0, zeros=[], poles=[]}", "")  # fmt: skip
    profile.write_text(profile.read_text() + "\n".join(plant))
    assert "days ago" not in findings(folder)[1]
    long_ago = time.time() - 200.0 * 86400.0
    os.utime(profile, (long_ago, long_ago))
    _, printed = findings(folder)
    assert "note     " in printed
    assert "was written 200 days ago" in printed
    with profile.open("a") as file:
        file.write('measured = "2020-01-31"\n')
    assert "was measured" in findings(folder)[1]


def test_doctor_lists_each_difference_from_printer_cfg(tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text('extends = "example-corexy"\n')
    done = run("doctor", "-p", other, "--printer-cfg", REAL)
    assert done.returncode == 1
    assert done.stdout.count(b"PROBLEM") == int(done.stdout.split()[-2])
    assert b"max_z_velocity: 20, but limits.z_velocity = 15" in done.stdout
    assert b"hframe-post 0" in done.stdout


def test_doctor_names_the_variable_that_chooses_another_profile(machine: Path) -> None:
    done = run("doctor", "-p", machine / "printer.toml", HFRAME_PRINTER="paper")
    assert done.returncode == 1
    assert b"takes paper (environment variable HFRAME_PRINTER), not " in done.stdout
    assert b"run 'unset HFRAME_PRINTER'" in done.stdout


def test_a_marlin_owner_is_told_of_no_printer_cfg(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text('extends = "example-ender"\n')
    done = run("doctor", "-p", own, HFRAME_PRINTER=str(own))
    assert done.returncode == 0
    assert done.stdout.endswith(b"no problems found\n")
    assert b"save its answers to M503" in done.stdout
    shipped = run("doctor", "-p", "example-ender", HFRAME_PRINTER="")
    assert b"run 'hframe-post setup m503.txt'" in shipped.stdout
    assert b"printer.cfg" not in done.stdout + shipped.stdout
    own.write_text('extends = "paper-marlin"\n[plant]\ninvented = false\n')
    for command in ("check", "verify"):
        printed = run(command, "-p", own, "--gcode", tmp_path / "a.gcode")
        assert printed.returncode == 1
        assert b"measure again: 'hframe-post sweep'" in printed.stderr
    converted = run("sample_gcode/rectangle.gcode", "-n", "-p", own)
    assert b"next             print it, and the file as sliced, and compare\n" in converted.stderr


def test_doctor_without_a_profile_checks_the_installation(tmp_path: Path) -> None:
    done = run("doctor", XDG_CONFIG_HOME=str(tmp_path), HFRAME_PRINTER="")
    assert done.returncode == 0
    assert b"note     no printer is chosen: make its profile with 'hframe-post setup" in done.stdout
    assert b"no problems found, but printer.cfg was not checked" in done.stdout
    checked = run("doctor", "--printer-cfg", REAL, XDG_CONFIG_HOME=str(tmp_path), HFRAME_PRINTER="")
    assert checked.returncode == 1
    assert b"PROBLEM  no printer is chosen" in checked.stdout


def test_an_unknown_key_may_be_of_a_newer_version(tmp_path: Path) -> None:
    newer = tmp_path / "newer.toml"
    newer.write_text('extends = "paper"\n[limits]\ncurvature = 3\n')
    done = run("doctor", "-p", newer)
    assert done.returncode == 1
    assert b"limits.curvature: unknown key" in done.stdout
    assert b"If a newer version wrote the profile, install that version" in done.stdout


def test_doctor_finds_other_problems(tmp_path: Path) -> None:
    (tmp_path / "no.cfg").write_text("[printer")
    assert b"PROBLEM  " in run("doctor", "--printer-cfg", tmp_path / "no.cfg").stdout
    (tmp_path / "bad.toml").write_text('extends = "paper"\nx = 1\n')
    assert run("doctor", "-p", tmp_path / "bad.toml").returncode == 1


def test_a_folder_that_cannot_be_written_is_a_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "cwd", lambda: tmp_path / "gone")
    missing = CliRunner().invoke(main, ["doctor"])
    assert missing.exit_code == 1
    assert "files cannot be written" in missing.output
