"""Profiles whose plant is a measured impulse response."""

from __future__ import annotations

from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import Array, X, Y
from hframe_post.errors import PrinterError
from hframe_post.model.impulse_response import ImpulseResponse, Linear, transfer_function
from hframe_post.model.plant import Coupling, Plant
from hframe_post.printer.edit import with_check, with_plant, with_verification
from hframe_post.printer.profile import load, parse
from tests.modes import deviation_of_mode

PAPER = load("paper")
WINDOWS = PAPER.compensation.windows
EARLY = np.concatenate([np.linspace(0.0, 0.4, 33), deviation_of_mode(45.0, 0.07, 400)])
BASE = 'extends = "example-corexy"\n[plant]\ninvented = false\n'


def measured(rest: float = 1.0, scale: float = 1.0) -> ImpulseResponse:
    return ImpulseResponse(scale * EARLY, 32, rest)


def deviation(G: Linear | None) -> Array:
    assert isinstance(G, ImpulseResponse)
    return G.deviation


def test_one_mode_is_written_in_micrometres() -> None:
    """A pulse of 1000 mm/s² for 1 ms is a step of 1 mm/s: the nozzle lags by 1/ω s at the most."""
    text = f"{BASE}[plant.Gxx]\nlead = 0\ndeviation = {deviation_of_mode(50.0, 0.01, 9).tolist()}\n"
    G = parse(text, "mine").plant.Gxx
    speed = np.concatenate([np.zeros(3), np.full(9, 1e-3)])  # mm/ms
    command = np.cumsum(speed)
    h = np.zeros(12)
    h[: len(G.impulse(12))] = G.impulse(12)
    nozzle = np.convolve(h, command)[:12]
    lag = 1e3 * (command - nozzle)[3:]  # µm
    assert lag[:8] == pytest.approx(-deviation(G)[1:9], abs=1e-9)
    assert lag[4] == pytest.approx(1e3 / (2.0 * np.pi * 50.0), rel=0.05)


def test_responses_are_written_as_they_are_read(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text('extends = "paper"  # mine\n')
    cross = (
        Coupling(Y, X, measured(0.0, 0.02)),
        Coupling(X, Y, measured(0.0, 1e-4), X, 120.0),
    )
    plant = Plant(measured(), measured(scale=0.7), measured(0.0, 1e-3), 140.0, cross)
    text = with_plant(str(mine), plant, WINDOWS, ["measured"], 0.02, measured=date(2026, 7, 1))

    found = parse(text, "mine").plant
    assert max(map(len, text.splitlines())) < 110
    pairs: list[tuple[Linear | None, Linear | None, float]] = [
        (found.Gxx, plant.Gxx, 1.0),
        (found.Gyy, plant.Gyy, 1.0),
        (found.Gxtheta, plant.Gxtheta, 1e-3),
    ]
    pairs += [(one.G, other.G, unit) for one, other, unit in zip(
        found.cross, plant.cross, (1.0, 1e-3), strict=True
    )]  # fmt: skip
    for one, other, unit in pairs:
        assert isinstance(one, ImpulseResponse)
        assert isinstance(other, ImpulseResponse)
        assert (one.lead, one.rest) == (other.lead, other.rest)
        assert np.abs(one.deviation - other.deviation).max() <= 0.5001e-4 * unit  # µm, or mrad
    mine.write_text(text)
    again = with_plant(str(mine), found, WINDOWS, ["measured"], 0.02, measured=date(2026, 7, 1))
    assert again == text  # what was read is written with the same digits


def test_a_verified_profile_and_its_digest_know_the_response(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    plant = replace(PAPER.plant, Gxx=measured(), Gyy=measured(), Gxtheta=None)
    mine.write_text(with_plant("example-corexy", plant, WINDOWS, []))
    mine.write_text(with_verification(str(mine), "2026-07-01", 0.9))
    verified = load(str(mine))
    assert verified.verified is not None

    text = mine.read_text()
    other = parse(text.replace("0.4000", "0.4001", 1), "mine")
    assert other.verified is None
    assert other.digest != verified.digest
    assert np.array_equal(deviation(other.plant.Gyy), deviation(verified.plant.Gyy))

    checked = parse(with_check(str(mine), {"Gyy": measured(scale=0.9)}, 0.03, None), "mine")
    assert checked.verified is not None
    assert deviation(checked.plant.Gyy) == pytest.approx(0.9 * EARLY, abs=1e-4)
    assert np.array_equal(deviation(checked.plant.Gxx), deviation(verified.plant.Gxx))


def test_both_kinds_may_stand_side_by_side() -> None:
    """What extends a profile replaces a transfer function as a whole."""
    text = f"{BASE}[plant.Gyy]\nlead = 32\ndeviation = {EARLY.tolist()}\n"
    plant = parse(text, "mine").plant
    assert transfer_function(plant.Gxx).order > 0
    assert np.array_equal(deviation(plant.Gyy), EARLY)
    assert plant.ahead == 32


def test_a_response_of_zeros_is_no_racking() -> None:
    text = 'extends = "paper"\n[plant.Gxtheta]\nlead = 0\ndeviation = [0.0, 0]\n'
    assert parse(text, "mine").plant.Gxtheta is None


@pytest.mark.parametrize(
    ("lines", "key", "cause"),
    [
        ("lead = 0", "Gxx.deviation", "the key is missing"),
        ("deviation = [0.0, 1.0]", "Gxx.lead", "the key is missing"),
        ("", "Gxx.zeros", "the key is missing"),
        ("lead = 0\ndeviation = [0.0]\ngain = 1.0", "Gxx.gain", "leave one of them out"),
        ("lead = 0\ndeviation = [0.0]\npoles = []", "Gxx.poles", "leave one of them out"),
        ("lead = 0\nzeros = []\npoles = []\ngain = 1.0", "Gxx.zeros", "leave one of them out"),
        ("lead = 0\ndeviation = []", "Gxx.deviation", "1 to 2000 numbers"),
        ("lead = 0\ndeviation = 1.0", "Gxx.deviation", "1 to 2000 numbers"),
        (f"lead = 0\ndeviation = {[0.0] * 2001}", "Gxx.deviation", "1 to 2000 numbers"),
        ("lead = 0\ndeviation = [[0.0, 1.0]]", "Gxx.deviation", "a number"),
        ("lead = 0\ndeviation = [nan]", "Gxx.deviation", "a number"),
        ("lead = 0\ndeviation = [inf]", "Gxx.deviation", "a number"),
        ("lead = 0\ndeviation = [true]", "Gxx.deviation", "a number"),
        ("lead = 0\ndeviation = [1e9]", "Gxx.deviation", "at most"),
        ("lead = 2\ndeviation = [0.0, 1.0]", "Gxx", "lead must be from 0 to 1"),
        ("lead = -1\ndeviation = [0.0, 1.0]", "Gxx", "lead must be from 0 to 1"),
        ("lead = 0.5\ndeviation = [0.0, 1.0]", "Gxx.lead", "a whole number"),
        ("lead = 0\ndeviations = [0.0]", "Gxx.deviations", "nearest known is 'deviation'"),
    ],
)
def test_a_bad_response_is_an_error_that_names_the_key(lines: str, key: str, cause: str) -> None:
    with pytest.raises(PrinterError) as error:
        parse(f"{BASE}[plant.Gxx]\n{lines}\n", "mine")
    assert error.value.key == f"plant.{key}"
    assert cause in error.value.cause


def test_a_coupling_is_one_kind_too() -> None:
    head = f'{BASE}[[plant.cross]]\nanswer = "y"\ncommand = "x"\n'
    coupling = parse(head + "lead = 1\ndeviation = [0.1, 0.2, 0.3]\n", "mine").plant.cross[0]
    assert deviation(coupling.G) == pytest.approx([0.1, 0.2, 0.3])
    assert coupling.G.dc_gain == 0.0
    with pytest.raises(PrinterError, match="leave one of them out"):
        parse(head + "lead = 1\ndeviation = [0.1, 0.2]\ngain = 1.0\n", "mine")
