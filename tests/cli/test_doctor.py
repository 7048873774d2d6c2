"""``doctor`` with and without problems; ``printers new`` from answers and from printer.cfg."""

from __future__ import annotations

from pathlib import Path

from hframe_post.printer.profile import load
from tests.command_line import RECTANGLE, run
from tests.printers import REAL


def test_doctor_finds_no_problem_in_a_new_profile_from_printer_cfg(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    made = run("printers", "new", "-o", own, "--printer-cfg", REAL, "--description", 'my "H"')
    assert b"Warning: --description will be removed" in made.stderr
    assert made.returncode == 0, made.stderr
    assert load(str(own)).description == 'my "H"'
    done = run("doctor", "-p", own, "--printer-cfg", REAL)
    assert done.returncode == 0, done.stdout
    assert b"no problems found" in done.stdout
    assert b"PROBLEM" not in done.stdout
    assert run(RECTANGLE, "-n", "-p", own).returncode == 0
    again = run("printers", "new", "-o", own, "--printer-cfg", REAL)
    assert again.returncode == 1
    assert b"exists already" in again.stderr


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


def test_a_new_profile_from_answers(tmp_path: Path) -> None:
    answers = b"Big Blue\ncorexy\n5,1\n0,310\n\n250\n2500\n\n\n\n\n\n"
    done = run("printers", "new", "-o", tmp_path / "blue.toml", stdin=answers)
    assert done.returncode == 0, done.stderr
    blue = load(str(tmp_path / "blue.toml"))
    assert blue.description == "Big Blue"
    assert blue.kinematics.type == "corexy"
    assert blue.travel.x == (0.0, 310.0)  # the second answer: the first was not a range
    assert (blue.limits.velocity, blue.limits.acceleration) == (250.0, 2500.0)
    assert not (tmp_path / "no.toml").exists()
    assert run("printers", "new", "-o", tmp_path / "no.toml", stdin=b"a\n").returncode == 1
    assert not (tmp_path / "no.toml").exists()
