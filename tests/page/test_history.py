"""The page of a printer's history: what has drifted, which checks there were, what was printed."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from hframe_post.hosts.moonraker.conversion import page_of
from hframe_post.hosts.moonraker.disk import Event, add
from tests.chromium import Browser
from tests.command_line import run
from tests.conftest import ROOT
from tests.page.pages import check_readable, data_of

DAY = 24 * 3600.0
EVIL = "<img src=x onerror=window.evil=1></script>.gcode"


def built(folder: Path) -> Path:
    """Return the page of a printer that was calibrated and checked, and printed a file."""
    now = time.time()
    for event in (
        Event("calibration", now - 9 * DAY, {"x": (43.4,)}),
        Event("check", now - 5 * DAY, {"x": (43.0, 40.0)}),
        Event("check", now - 4 * DAY, {"x": (40.0, 40.0)}),
        Event("check", now - 1 * DAY, reason="the model was not changed"),
        Event("conversion", now, name=EVIL, rms_um=(90.0, 2.5), seconds=(1135.0, 1129.0)),
    ):
        add(folder, event)
    page, profile = folder / "page.html", ROOT / "tests/measured.toml"
    # its status is that of doctor, who may find a problem on this computer
    done = run("doctor", "-p", profile, "--history", folder, "--report", page)
    assert done.stderr == b""
    return page


def test_it_shows_drift_checks_and_prints(tmp_path: Path) -> None:
    data = data_of(built(tmp_path))
    drift, prints = data["sections"]
    _, text, address = prints["rows"][0]
    assert text == f"{EVIL}, 90.0 → 2.5 µm RMS, 18m 55s → 18m 49s"
    assert address == page_of(EVIL)
    (x,) = drift["charts"][0]["lines"]
    assert x["label"] == "x"
    assert x["at"] == pytest.approx([-9.0, -5.0, -4.0], abs=0.1)
    # a calibration counts with what the check after it found in its model
    assert x["y"] == pytest.approx([0.0, *2 * [100.0 * (40.0 / 43.0 - 1.0)]], abs=0.01)
    assert [text for _, text in drift["rows"]] == [
        "check: the model was not changed", "check: x 40.0 → 40.0 Hz",
        "check: x 43.0 → 40.0 Hz", "calibration: x 43.4 Hz",
    ]  # fmt: skip
    cards = {card["what"]: (card["value"], card["kind"]) for card in data["cards"]}
    assert cards["Uncertainty today"] == ("unknown", "")
    assert cards["Last check"] == ("1", "bad")
    assert cards["Drift of x"] == ("−7.0", "bad")


@pytest.mark.slow
def test_it_can_be_read_and_runs_no_name(browser: Browser, tmp_path: Path, artefacts: Path) -> None:
    path = built(tmp_path)
    for width in (1280, 390):
        for dark in (False, True):
            browser.screen(width, 844, dark)
            browser.open(path)
            check_readable(browser, width)
            browser.shot(artefacts / f"history-{width}-{'dark' if dark else 'light'}.png", True)
    assert EVIL in browser.value("document.getElementById('sections').textContent")
    assert browser.value("window.evil") is None
    assert browser.complaints == []
