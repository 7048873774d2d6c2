"""Profiles whose plant is a measured impulse response."""

from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from hframe_post.errors import PrinterError
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.printer.profile import load, parse
from tests.plants import deviation_of_mode
from tests.printers import with_plant

PAPER = load("paper")
WINDOWS = PAPER.compensation.windows
EARLY = np.concatenate([np.linspace(0.0, 0.4, 33), deviation_of_mode(45.0, 0.07, 400)])
BASE = 'extends = "example-corexy"\n[plant]\ninvented = false\n'


def measured(rest: float = 1.0, scale: float = 1.0) -> ImpulseResponse:
    return ImpulseResponse(scale * EARLY, 32, rest)


def doubted(rest: float = 1.0, scale: float = 1.0) -> ImpulseResponse:
    """Return a response with a lag, of which it is said how well it is known."""
    unknown = 0.05 * scale * EARLY[32:200]
    return replace(measured(rest, scale), lag=round(2.3 * scale, 7), drift=0.02, unknown=unknown)


def test_responses_read_back(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text('extends = "paper"  # mine\n')
    plant = Plant(doubted(), doubted(scale=0.7), doubted(0.0, 1e-3), 140.0)
    text = with_plant(str(mine), plant, WINDOWS, ["measured"], 0.02, measured=date(2026, 7, 1))

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
    again = with_plant(str(mine), found, WINDOWS, ["measured"], 0.02, measured=date(2026, 7, 1))
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
