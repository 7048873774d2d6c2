"""``doctor`` with and without problems."""

from __future__ import annotations

from pathlib import Path

from tests.command_line import run
from tests.printers import REAL


def test_doctor_finds_no_problem_in_a_new_profile_from_printer_cfg(tmp_path: Path) -> None:
    made = run("setup", REAL, "-o", tmp_path, XDG_CONFIG_HOME=str(tmp_path / "config"))
    assert made.returncode == 0, made.stderr
    done = run("doctor", "-p", tmp_path / "printer.toml", "--printer-cfg", REAL)
    assert done.returncode == 0, done.stdout
    assert b"no problems found" in done.stdout
    assert b"PROBLEM" not in done.stdout


def test_doctor_lists_each_difference_from_printer_cfg(tmp_path: Path) -> None:
    done = run("doctor", "-p", "example-corexy", "--printer-cfg", REAL)
    assert done.returncode == 1
    assert done.stdout.count(b"PROBLEM") == int(done.stdout.split()[-2])
    assert b"max_z_velocity: 20, but limits.z_velocity = 15" in done.stdout
    assert b"hframe-post 0" in done.stdout


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
    missing = run("doctor", "--folder", tmp_path / "gone")
    assert missing.returncode == 1
    assert b"files cannot be written" in missing.stdout
