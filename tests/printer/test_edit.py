"""Changes to a profile's text keep everything else, comments included."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post.errors import PrinterError
from hframe_post.model.lpfbs import Window
from hframe_post.printer.edit import with_plant, with_windows
from hframe_post.printer.profile import load, parse, shipped
from tests.coupled import coupled_plant

PAPER = shipped()["paper"]
KEYS = ("L", "n_C", "n_up", "effort")
SETTING = re.compile(rb"\s*(?:L|n_C|n_up|effort)\s*=")


def pair() -> tuple[Window, Window]:
    return Window(8, 55, 27, 30.0), Window(8, 55, 27, 58.75)


@st.composite
def windows(draw: st.DrawFn) -> tuple[Window, Window]:
    L = draw(st.integers(2, 500))
    n_C = draw(st.integers(1, 2000 // L))
    n_up = draw(st.integers(1, n_C))
    x, y = (Window(L, n_C, n_up, draw(st.floats(0.0, 1e12))) for _ in range(2))
    return x, y


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("profile") / "mine.toml"


def changed(path: Path, text: str | bytes) -> bytes:
    """Return the profile with that text after changing the windows to those of ``pair``."""
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return with_windows(str(path), pair()).encode()


def others(text: bytes) -> list[bytes]:
    """Return all lines except the four settings."""
    return [line for line in text.splitlines(keepends=True) if not SETTING.match(line)]


@given(windows())
@settings(max_examples=30)
def test_what_is_written_is_what_is_loaded(mine: Path, chosen: tuple[Window, Window]) -> None:
    mine.write_text(PAPER, encoding="utf-8")
    mine.write_text(with_windows(str(mine), chosen), encoding="utf-8")
    profile, before = load(str(mine)), load("paper")
    assert profile.compensation.windows == chosen
    assert (profile.limits, profile.travel, profile.motors, profile.firmware) == (
        before.limits, before.travel, before.motors, before.firmware,
    )  # fmt: skip
    assert profile.compensation.stops == before.compensation.stops
    again = with_windows(str(mine), before.compensation.windows)
    assert tomllib.loads(again) == tomllib.loads(PAPER)


@pytest.mark.parametrize("newline", ["\n", "\r\n"], ids=["unix", "windows"])
def test_all_other_bytes_stay(mine: Path, newline: str) -> None:
    before = PAPER.replace("\n", newline).encode()
    after = changed(mine, before)
    assert others(after) == others(before)
    one, other = before.splitlines(keepends=True), after.splitlines(keepends=True)
    differing = [(a, b) for a, b in zip(one, other, strict=True) if a != b]
    assert len(differing) == len(KEYS)
    for a, b in differing:
        assert a.partition(b"#")[1:] == b.partition(b"#")[1:]  # comments with their line's end


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("newline", ["\n", "\r\n"], ids=["unix", "windows"])
def test_a_setting_that_the_base_makes_is_added(mine: Path, key: str, newline: str) -> None:
    given = {"L": "5", "n_C": "88", "n_up": "44", "effort": "[1, 2]"}
    stated = [f"{name} = {value}" for name, value in given.items() if name != key]
    head = ['extends = "paper" # mine', "[compensation]  # tuned", 'strategy = "fbs"']
    tail = ["[limits] # L = 3", "velocity = 100", ""]
    before = newline.join([*head, *stated, *tail]).encode()
    after = changed(mine, before)
    assert parse(after.decode(), "mine").compensation.windows == pair()
    assert others(after) == others(before)
    assert after.count(b"\r") == (after.count(b"\n") if newline == "\r\n" else 0)


def test_a_profile_without_the_table_is_given_one(mine: Path) -> None:
    before = b'extends = "paper"  # the base\n\n[limits]\nvelocity = 100 # slow\n'
    after = changed(mine, before)
    assert after.startswith(before)
    profile = parse(after.decode(), "mine")
    assert profile.compensation.windows == pair()
    assert profile.limits.velocity == 100.0


def test_an_empty_table_at_the_end_of_the_file_is_filled(mine: Path) -> None:
    for ending in ("", "\n", " # nothing yet", "\r\n"):
        after = changed(mine, f'extends = "paper"\n[compensation]{ending}')
        assert parse(after.decode(), "mine").compensation.windows == pair()
        assert after.startswith(b'extends = "paper"\n[compensation]')


def test_a_shipped_profile_is_extended() -> None:
    for name in shipped():
        text = with_windows(name, pair())
        assert tomllib.loads(text)["extends"] == name
        assert tomllib.loads(text).keys() == {"extends", "compensation"}
        profile = parse(text, "mine")
        assert profile.compensation.windows == pair()
        assert profile.limits == load(name).limits
        assert profile.kinematics == load(name).kinematics


def test_settings_of_other_tables_and_in_comments_are_left_alone(mine: Path) -> None:
    before = (
        'extends = "paper"\n# [compensation]\n# L = 1\n[compensation]\n# L = 2, n_C = 3\n'
        "L = 5 # L = 6\nn_C=88\n  n_up  =  44\neffort = [1,2]# [ 3 ]\n\n[steps]\n"
        "belt = 0.01\nz = 0.01\ne = 0.01\nclock_hz = 1e5\n"
    )
    after = changed(mine, before).decode()
    stated = ("L = 8 # L = 6", "n_C=55", "  n_up  =  27", "effort = [30.0,58.75]# [ 3 ]")
    for line in stated:
        assert line in after.splitlines()
    assert others(after.encode()) == others(before.encode())


@pytest.mark.parametrize(
    ("text", "kept"),
    [
        ("compensation.L = 5 # dotted\n[limits]\njerk = 1e6\n", "compensation.L = 8 # dotted"),
        ("compensation = { L = 5 } # inline\n", "# inline"),
        ('["compensation"] # quoted\nL = 5\n', '["compensation"] # quoted'),
        ('[compensation]\n"L" = 5 # quoted\n', '"L" = 8 # quoted'),
        ("[compensation]\neffort = [\n  1.0, # of x\n  2.0,\n]\n", "  30.0, # of x"),
        ("[compensation]\neffort = [ # one\n1.0,\n2.0,\n3.0]\nL=5 #five\n", "L=8 #five"),
        ('description = """\n[compensation]\n"""\n[compensation]\nL = 5 # in\n', "L = 8 # in"),
        ("[firmware]\n[compensation]\n[firmware.klipper]\nvelocity = 90 # out of order\n",
         "velocity = 90 # out of order"),
    ],
    ids=["dotted", "inline", "quoted table", "quoted key", "many lines", "too many numbers",
         "in a text", "out of order"],
)  # fmt: skip
@pytest.mark.parametrize("newline", ["\n", "\r\n"], ids=["unix", "windows"])
def test_any_layout_is_kept(mine: Path, text: str, kept: str, newline: str) -> None:
    text = 'extends = "paper"  # mine\n' + text
    after = changed(mine, text.replace("\n", newline)).decode()
    assert after.startswith('extends = "paper"  # mine')
    assert kept in after
    own, before = tomllib.loads(after), tomllib.loads(text)
    windows = {"L": 8, "n_C": 55, "n_up": 27, "effort": [30.0, 58.75]}
    assert own == {**before, "compensation": {**before.get("compensation", {}), **windows}}
    assert after.count("\r") == (after.count("\n") if newline == "\r\n" else 0)


@pytest.mark.parametrize(
    "text",
    [
        "[plant]\nx_c = 3 # old\n[limits]\njerk = 1e6 # mine\n[plant.Gyy]\ngain = 0.5\n"
        "zeros = []\npoles = [[0.5, 0.0]]\n[motors]\nbelt_velocity = 600 # theirs\n",
        "plant.x_c = 3 # old\nlimits.jerk = 1e6 # mine\nmotors = { belt_velocity = 600 }#theirs\n",
    ],
    ids=["scattered", "dotted"],
)
def test_a_plant_replaces_the_old_one_wherever_it_is_written(mine: Path, text: str) -> None:
    mine.write_text('extends = "paper"\n' + text)
    plant = load("paper-strong").plant
    after = with_plant(str(mine), plant, pair(), ["found today", ""])
    profile = parse(after, "mine")
    assert profile.compensation.windows == pair()
    assert profile.plant.x_c == plant.x_c
    np.testing.assert_allclose(profile.plant.Gyy.deviation, plant.Gyy.deviation, atol=1e-4)
    assert (profile.limits.jerk, profile.motors.belt_velocity) == (1e6, 600.0)
    assert "# mine" in after
    assert "theirs" in after
    assert "# found today" in after
    assert "old" not in after


def test_couplings_are_written_as_they_are_read(mine: Path) -> None:
    plant = coupled_plant(1, racks=True)
    mine.write_text('extends = "paper"\n')
    found = parse(with_plant(str(mine), plant, pair(), []), "mine").plant
    assert len(found.cross) == len(plant.cross) == 4
    for one, other in zip(found.couplings, plant.couplings, strict=True):
        assert (one.answer, one.command) == (other.answer, other.command)
        assert (one.along, one.centre) == (other.along, other.centre)
        np.testing.assert_allclose(one.G.deviation, other.G.deviation, atol=1e-4)


def test_a_file_that_was_spoiled_meanwhile_is_told_about(mine: Path) -> None:
    mine.write_text("[compensation\n")
    with pytest.raises(PrinterError, match="L = 8, n_C = 55, n_up = 27"):
        with_windows(str(mine), pair())
    mine.write_text('extends = "paper"\n[limits]\nvelocity = -1\n')
    with pytest.raises(PrinterError) as caught:
        with_windows(str(mine), pair())
    assert caught.value.key == "limits.velocity"
