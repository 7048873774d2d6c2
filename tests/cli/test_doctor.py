"""``doctor`` on a right and on a wrong printer; ``printers new`` by questions and by file."""

from __future__ import annotations

from pathlib import Path

from hframe_post.printer.profile import load
from tests.command_line import RECTANGLE, run
from tests.printers import REAL


def test_a_new_profile_from_printer_cfg_is_found_well(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    made = run("printers", "new", "-o", own, "--printer-cfg", REAL, "--description", 'my "H"')
    assert made.returncode == 0, made.stderr
    assert load(str(own)).description == 'my "H"'
    well = run("doctor", "-p", own, "--printer-cfg", REAL, "--folder", tmp_path)
    assert well.returncode == 0, well.stdout
    assert b"all is well" in well.stdout
    assert b"WRONG" not in well.stdout
    assert run(RECTANGLE, "-n", "-p", own).returncode == 0
    again = run("printers", "new", "-o", own, "--printer-cfg", REAL)
    assert again.returncode == 1
    assert b"is there already" in again.stderr


def test_a_wrong_printer_cfg_is_status_1_with_each_difference(tmp_path: Path) -> None:
    done = run("doctor", "-p", "example-corexy", "--printer-cfg", REAL)
    assert done.returncode == 1
    assert done.stdout.count(b"WRONG") == int(done.stdout.split()[-2])
    assert b"max_z_velocity: 20, but limits.z_velocity = 15" in done.stdout
    assert b"hframe-post 0" in done.stdout


def test_an_older_profile_is_read_and_a_newer_one_is_told_of(tmp_path: Path) -> None:
    older, newer = tmp_path / "older.toml", tmp_path / "newer.toml"
    own = tmp_path / "own.toml"
    assert run("printers", "new", "-o", own, "--printer-cfg", REAL).returncode == 0
    older.write_text(own.read_text().replace("[firmware.klipper]", "[firmware.restore]"))
    assert "[firmware.restore]" in older.read_text()
    assert run("doctor", "-p", older, "--printer-cfg", REAL).returncode == 0
    newer.write_text('extends = "paper"\n[limits]\ncurvature = 3\n')
    done = run("doctor", "-p", newer)
    assert done.returncode == 1
    assert b"limits.curvature: unknown key" in done.stdout
    assert b"if a newer one wrote the profile, install that" in done.stdout


def test_what_else_can_be_wrong(tmp_path: Path) -> None:
    (tmp_path / "no.cfg").write_text("[printer")
    assert b"WRONG  " in run("doctor", "--printer-cfg", tmp_path / "no.cfg").stdout
    (tmp_path / "bad.toml").write_text('extends = "paper"\nx = 1\n')
    assert run("doctor", "-p", tmp_path / "bad.toml").returncode == 1
    gone = run("doctor", "--folder", tmp_path / "gone")
    assert gone.returncode == 1
    assert b"cannot be written" in gone.stdout


def test_a_new_profile_from_answers(tmp_path: Path) -> None:
    answers = b"Big Blue\ncorexy\n5,1\n0,310\n\n250\n2500\n\n\n\n\n\n"
    done = run("printers", "new", "-o", tmp_path / "blue.toml", stdin=answers)
    assert done.returncode == 0, done.stderr
    blue = load(str(tmp_path / "blue.toml"))
    assert blue.description == "Big Blue"
    assert blue.kinematics.type == "corexy"
    assert blue.travel.x == (0.0, 310.0)  # the second answer: the first was no range
    assert (blue.limits.velocity, blue.limits.acceleration) == (250.0, 2500.0)
    assert not (tmp_path / "no.toml").exists()
    assert run("printers", "new", "-o", tmp_path / "no.toml", stdin=b"a\n").returncode == 1
    assert not (tmp_path / "no.toml").exists()
