"""A measured model: in a file of its own, next to the profile that names it, and in a profile."""

import tomllib
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from hframe_post.errors import PrinterError
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.printer.model_file import measured, model_path, texts
from hframe_post.printer.profile import load, parse
from hframe_post.printer.settings import Printer, Verified
from tests.plants import deviation_of_mode
from tests.printers import in_two, with_plant

WINDOWS = Window(8, 55, 27, 30.0), Window(8, 55, 27, 58.75)


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    return tmp_path / "mine.toml"


def identified(source: str, plant_of: str = "paper-strong") -> Printer:
    plant = load(plant_of).plant
    return measured(load(source), plant, 0.03, date(2026, 7, 1)).with_windows(WINDOWS)


def test_a_profile_names_its_model_and_keeps_its_text(mine: Path) -> None:
    before = 'extends = "paper"  # mine\n[limits] # L = 3\njerk = 1e6 # slow\n'
    mine.write_text(before)
    in_two(mine, identified(str(mine)), str(mine), ["found today", ""])
    assert mine.read_text() == f'model = "mine.model.toml"\n{before}'
    assert "# found today\n#\ninvented = false" in model_path(mine).read_text()
    found = load(str(mine))
    assert found.compensation.windows == WINDOWS
    assert found.plant.x_c == load("paper-strong").plant.x_c
    assert (found.uncertainty, found.measured, found.invented) == (0.03, date(2026, 7, 1), False)
    assert found.limits.jerk == 1e6


def test_the_owners_keys_count_more_than_the_models(mine: Path) -> None:
    mine.write_text('extends = "paper"\n')
    in_two(mine, identified(str(mine)), str(mine))
    with mine.open("a") as file:
        file.write("[compensation]\neffort = [1.0, 2.0]\n[plant]\nuncertainty = 0.2\n")
    found = load(str(mine))
    assert found.compensation.effort == (1.0, 2.0)
    assert found.compensation.n_C == 55
    assert found.uncertainty == 0.2
    assert found.measured == date(2026, 7, 1)


@pytest.mark.parametrize("newline", ["\n", "\r\n"], ids=["unix", "windows"])
@pytest.mark.parametrize(
    "text",
    [
        "[plant]\nx_c = 3 # old\n[limits]\njerk = 1e6 # mine\n[plant.Gyy]\ngain = 0.5\n"
        "zeros = []\npoles = [[0.5, 0.0]]\n[motors]\nbelt_velocity = 600 # theirs\n"
        "[compensation]\nL = 5 # old\nstops = 'exact'\n",
        "plant.x_c = 3 # old\nlimits.jerk = 1e6 # mine\nmotors = { belt_velocity = 600 }#theirs\n"
        "compensation = { L = 5, stops = 'exact' }\n",
    ],
    ids=["scattered", "dotted"],
)
def test_a_plant_in_the_profile_goes(mine: Path, text: str, newline: str) -> None:
    mine.write_bytes(f'extends = "paper"\n{text}'.replace("\n", newline).encode())
    made = texts(identified(str(mine)), str(mine), mine, [])
    mine.write_bytes(made.profile.encode())
    model_path(mine).write_text(made.model)
    found = load(str(mine))
    assert found.compensation.windows == WINDOWS
    assert found.compensation.stops == "exact"
    ours, theirs = (one.plant.Gyy.deviation for one in (found, load("paper-strong")))
    np.testing.assert_allclose(ours, theirs, atol=1e-4)
    assert (found.limits.jerk, found.motors.belt_velocity) == (1e6, 600.0)
    assert "# mine" in made.profile
    assert "theirs" in made.profile
    assert "old" not in made.profile
    assert made.profile.count("\r") == (made.profile.count("\n") if newline == "\r\n" else 0)


def test_what_is_measured_again_keeps_the_comments_and_the_profiles_bytes(mine: Path) -> None:
    mine.write_text('extends = "paper"\n')
    in_two(mine, identified(str(mine)), str(mine), ["found today", "by me"])
    profile, first = mine.read_bytes(), model_path(mine).read_text()
    in_two(mine, replace(load(str(mine)), uncertainty=0.04), str(mine))
    assert mine.read_bytes() == profile
    assert model_path(mine).read_text() == first.replace("= 0.03", "= 0.04")


def test_a_mark_holds_for_this_model_and_window_alone(mine: Path) -> None:
    mine.write_text('extends = "paper"\n')
    in_two(mine, identified(str(mine)), str(mine))
    before = load(str(mine))
    mark = Verified("2026-07-02", 0.9, "klipper", before.model)
    in_two(mine, replace(before, verified=mark), str(mine))
    assert load(str(mine)).verified == mark
    with mine.open("a") as file:
        file.write("[compensation]\nL = 9\n")
    assert load(str(mine)).verified is None


def test_a_copy_elsewhere_gets_a_model_of_its_own(mine: Path) -> None:
    mine.write_text('extends = "paper"\n')
    in_two(mine, identified(str(mine)), str(mine))
    other = mine.with_name("other.toml")
    in_two(other, load(str(mine)), str(mine))
    assert tomllib.loads(other.read_text())["model"] == "other.model.toml"
    model_path(mine).unlink()
    assert load(str(other)).compensation.windows == WINDOWS


def test_the_mass_of_a_bed_is_part_of_the_model(mine: Path) -> None:
    mine.write_text('extends = "example-cartesian"\n[plant]\nmoving_mass = 0.8\n')
    before = identified(str(mine), "example-cartesian")
    in_two(mine, before, str(mine))
    found = load(str(mine))
    assert found.plant.bed is not None
    assert found.plant.bed.mass == 0.8


@pytest.mark.parametrize(
    ("model", "cause"),
    [
        (None, "there is no .*gone.toml, which 'hframe-post identify' writes"),
        ("[plant\n", "gone.toml: not valid TOML"),
        ("[limits]\n", "unknown key"),
        ("plant = 3\n", "other things than tables"),
        ("[compensation]\n", "plant: the table is missing"),
    ],
)
def test_a_missing_or_broken_model_is_named(mine: Path, model: str | None, cause: str) -> None:
    mine.write_text('extends = "paper"\nmodel = "gone.toml"\n')
    if model is not None:
        mine.with_name("gone.toml").write_text(model)
    with pytest.raises(PrinterError, match=cause):
        load(str(mine))
    with pytest.raises(PrinterError, match="name of a file"):
        parse('extends = "paper"\nmodel = 3\n', "mine")


PAPER = load("paper")
OF_PAPER = PAPER.compensation.windows
EARLY = np.concatenate([np.linspace(0.0, 0.4, 33), deviation_of_mode(45.0, 0.07, 400)])
BASE = 'extends = "example-corexy"\n[plant]\ninvented = false\n'


def response(rest: float = 1.0, scale: float = 1.0) -> ImpulseResponse:
    return ImpulseResponse(scale * EARLY, 32, rest)


def doubted(rest: float = 1.0, scale: float = 1.0) -> ImpulseResponse:
    """Return a response with a lag, of which it is said how well it is known."""
    unknown = 0.05 * scale * EARLY[32:200]
    return replace(response(rest, scale), lag=round(2.3 * scale, 7), drift=0.02, unknown=unknown)


def test_responses_read_back(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text('extends = "paper"  # mine\n')
    plant = Plant(doubted(), doubted(scale=0.7), doubted(0.0, 1e-3), 140.0)
    text = with_plant(str(mine), plant, OF_PAPER, ["response"], 0.02, measured=date(2026, 7, 1))

    found = parse(text, "mine").plant
    assert max(map(len, text.splitlines())) < 110
    pairs: list[tuple[ImpulseResponse | None, ImpulseResponse | None, float]] = [
        (found.Gxx, plant.Gxx, 1.0),
        (found.Gyy, plant.Gyy, 1.0),
        (found.Gxtheta, plant.Gxtheta, 1e-3),
    ]
    for one, other, unit in pairs:
        assert isinstance(one, ImpulseResponse)
        assert isinstance(other, ImpulseResponse)
        assert (one.lead, one.rest) == (other.lead, other.rest)
        assert np.abs(one.deviation - other.deviation).max() <= 0.5001e-4 * unit  # µm, or mrad
        assert one.lag == pytest.approx(other.lag, abs=5e-5 * unit)
        assert one.drift == other.drift
        assert one.unknown == pytest.approx(other.unknown, abs=0.5001e-4 * unit)
    mine.write_text(text)
    again = with_plant(str(mine), found, OF_PAPER, ["response"], 0.02, measured=date(2026, 7, 1))
    assert again == text  # what was read is written with the same digits


@pytest.mark.parametrize(
    ("lines", "key", "cause"),
    [
        ("lead = 0", "Gxx.deviation", "the key is missing"),
        ("", "Gxx.zeros", "the key is missing"),
        ("lead = 0\ndeviation = [0.0]\ngain = 1.0", "Gxx.gain", "leave one of them out"),
        ("lead = 0\ndeviation = []", "Gxx.deviation", "1 to 4000 numbers"),
        ("lead = 0\ndeviation = [nan]", "Gxx.deviation", "a number"),
        ("lead = 2\ndeviation = [0.0, 1.0]", "Gxx", "lead must be from 0 to 1"),
        ("lead = 0\ndeviation = [0.0]\nlag = 1e4", "Gxx.lag", "at most 1000"),
        ("lead = 0\ndeviation = [0.0]\ndrift = 1.0", "Gxx.drift", "at most 0.99"),
        ("lead = 0\ndeviation = [0.0]\nunknown = 0.1", "Gxx.unknown", "1 to 4000 numbers"),
        ("lead = 0\ndeviation = [0.0]\nx = 1.0", "Gxx.x", "one response holds all along x"),
        ("lead = 0\ndeviations = [0.0]", "Gxx.deviations", "nearest known is 'deviation'"),
    ],
)
def test_a_bad_response_is_an_error_that_names_the_key(lines: str, key: str, cause: str) -> None:
    with pytest.raises(PrinterError) as error:
        parse(f"{BASE}[plant.Gxx]\n{lines}\n", "mine")
    assert error.value.key == f"plant.{key}"
    assert cause in error.value.cause
