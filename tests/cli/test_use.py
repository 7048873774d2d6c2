"""Choice of the profile; the summary names it and the reason."""

import json
from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner

from hframe_post.cli.main import main
from hframe_post.printer.choice import choose, set_default
from tests.command_line import RECTANGLE, run


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "my printer.toml"
    path.write_text('extends = "paper"\n[plant]\ninvented = false\n')
    return path


def test_a_chosen_profile_is_used_until_forgotten(own: Path, tmp_path: Path) -> None:
    at_home = partial(run, XDG_CONFIG_HOME=str(tmp_path / "config"), HFRAME_PRINTER="")
    assert at_home("setup", own).returncode == 0
    used = at_home(RECTANGLE, "-n").stderr.decode()
    assert f"\nprofile          {own} (default set by 'hframe-post setup')\n" in used
    assert str(own) in at_home("doctor").stdout.decode()
    summary = json.loads(at_home(RECTANGLE, "-n", "-q", "--json", "-").stdout)
    assert summary["profile"] == str(own)
    (tmp_path / "config" / "hframe-post" / "config.toml").unlink()
    nothing = at_home(RECTANGLE, "-n")
    assert nothing.returncode == 1
    assert b"no printer is chosen: make its profile with 'hframe-post setup" in nothing.stderr


def test_the_more_specific_choice_wins(own: Path, tmp_path: Path) -> None:
    at_home = partial(run, XDG_CONFIG_HOME=str(tmp_path / "config"), HFRAME_PRINTER="")
    at_home("setup", own)
    varied = partial(at_home, HFRAME_PRINTER="paper-marlin")
    noted = partial(varied, SLIC3R_PRINTER_NOTES=r"2021\nHFRAME_PRINTER=paper-strong\nblue")
    chosen = {
        "paper-marlin (environment variable HFRAME_PRINTER)": varied(RECTANGLE, "-n"),
        "paper-strong (printer notes": noted(RECTANGLE, "-n"),
        "paper (option -p": noted(RECTANGLE, "-n", "-p", "paper"),
    }
    for start, done in chosen.items():
        assert "\nprofile          " + start in done.stderr.decode()


def test_a_bad_profile_is_refused_and_a_missing_one_is_an_error(own: Path, tmp_path: Path) -> None:
    at_home = partial(run, XDG_CONFIG_HOME=str(tmp_path / "config"), HFRAME_PRINTER="")
    (tmp_path / "bad.toml").write_text('extends = "paper"\nnonsense = 1\n')
    assert at_home("setup", tmp_path / "bad.toml").returncode == 1
    assert not (tmp_path / "config").exists()
    at_home("setup", own)
    own.unlink()
    lost = at_home(RECTANGLE, "-n")
    assert lost.returncode == 1
    assert b"does not exist any more" in lost.stderr
    assert at_home(RECTANGLE, "-n", "-p", "paper").returncode == 0


def test_a_broken_configuration_is_an_error(tmp_path: Path) -> None:
    config = tmp_path / "hframe-post" / "config.toml"
    config.parent.mkdir()
    for text in ("printer = ", "printer = 3", "\xff"):
        config.write_text(text, "latin-1")
        done = run(RECTANGLE, "-n", XDG_CONFIG_HOME=str(tmp_path), HFRAME_PRINTER="")
        assert done.returncode == 1
        assert b"config.toml" in done.stderr
        assert done.stderr.count(b"\n") == 1


@pytest.mark.parametrize(
    ("notes", "profile"),
    [
        ("HFRAME_PRINTER=my.toml", "my.toml"),
        (r"HFRAME_PRINTER = C:\\Users\\rosa\\my.toml", r"C:\Users\rosa\my.toml"),
        (r"a\nHFRAME_PRINTER=\"/home/a b/my.toml\"\nb", "/home/a b/my.toml"),
        ("a\nHFRAME_PRINTER=big blue.toml\r\nb", "big blue.toml"),
    ],
)
def test_the_profile_in_the_slicers_printer_notes(notes: str, profile: str) -> None:
    assert choose(None, {"SLIC3R_PRINTER_NOTES": notes}).profile == profile


def test_the_profile_of_this_folder_comes_before_the_default(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its errors name its file."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.delenv("HFRAME_PRINTER")
    set_default(str(own))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert choose(None, {}).profile == str(own)
    Path("printer.toml").write_text('extends = "paper"\n[plant]\ninvented = true\n')
    assert choose(None, {}).as_text() == "profile          printer.toml (of this folder)"
    done = CliRunner().invoke(main, [str(RECTANGLE), "-o", "out.gcode"])
    assert "Error: printer.toml: this printer is not measured yet" in done.stderr
