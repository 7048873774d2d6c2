"""The report as a page: whole, small, harmless, and alive in a real browser."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.library import convert
from hframe_post.printer.settings import Printer
from tests.chromium import Browser
from tests.command_line import run
from tests.conftest import SAMPLES
from tests.page.pages import RATIOS, check_readable, data_of

EVIL = "</script><script>window.evil=1</script><img src=x onerror=window.evil=2>"
BOX = "['left', 'top', 'width', 'height'].map(side => canvas.getBoundingClientRect()[side])"


def sliced(feature: str = "WALL-OUTER") -> bytes:
    """Three layers of a square, with places and names of our choice."""
    lines = ["M83", "G28", "G1 Z5 F600", "G0 X100 Y100 F9000"]
    for layer in range(3):
        lines += [f";LAYER:{layer}", f";TYPE:{feature}", f"G1 Z{0.2 * (layer + 1):.1f} F600"]
        for x, y in ((140, 100), (140, 130), (100, 130), (100, 100)):
            lines.append(f"G1 X{x} Y{y} E1 F6000")
    return ("\n".join(lines) + f"\n; {EVIL}\nM104 S0\n").encode()


def built(paper: Printer, text: bytes, path: Path, name: str = "square.gcode") -> bytes:
    """The page of a conversion, also written to the path."""
    lines = text.splitlines(keepends=True)
    convert(lines, None, paper, page=path, title=name, notes=["profile          p"])
    return path.read_bytes()


def test_it_needs_no_network_and_what_files_say_is_data(paper: Printer, tmp_path: Path) -> None:
    html, again = (
        built(paper, sliced(EVIL), tmp_path / name, EVIL) for name in ("1.html", "2.html")
    )
    assert html == again
    assert EVIL.encode() not in html
    assert html.count(b"<script") == html.count(b"</script>") == 4
    assert b"<img" not in html
    assert not re.search(rb"(src|href)=[\"'](?!data:)", html)
    assert b"http" not in html.replace(b"http-equiv", b"")
    assert data_of(html)["name"] == EVIL
    assert EVIL in str(data_of(html)["features"])


def test_a_simulation_writes_it_too(tmp_path: Path) -> None:
    part, report = SAMPLES / "rectangle.gcode", tmp_path / "report.html"
    assert run("simulate", part, "--plant", "paper", "--report", report).returncode == 0
    assert data_of(report.read_bytes())["name"] == "rectangle.gcode"


@pytest.mark.slow
def test_controls_change_what_they_should(browser: Browser, paper: Printer, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    built(paper, sliced(), path)
    browser.screen(1280, 1500)
    assert browser.open(path) < 10.0
    assert browser.value("document.getElementById('where').textContent").startswith("Layer 1 (")

    browser.value("layer = document.getElementById('layer'); layer.value = 2; "
                  "layer.dispatchEvent(new Event('input'))")  # fmt: skip
    assert browser.value("document.getElementById('where').textContent").startswith("Layer 2 (")

    frame = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
    browser.value(frame)
    coloured = browser.value("canvas.toDataURL()")
    browser.value("document.querySelectorAll('#strategies button')[0].click()")
    browser.value(frame)
    assert browser.value("canvas.toDataURL()") != coloured
    assert browser.value("state.strategy") == 0

    left, top, width, height = browser.value(BOX)
    x, y = browser.value("toScreen(120, 100, canvas.getBoundingClientRect())")
    assert 0 < x < width
    assert 0 < y < height
    browser.click(left + x, top + y)
    browser.value("new Promise(done => setTimeout(done, 300))")
    place = browser.value("document.getElementById('place').textContent")
    assert "G1 X140 Y100 E1 F6000" in place
    assert "line 22" in place
    assert "WALL-OUTER" in place
    assert "no compensation" in place

    scale = browser.value("state.scale")
    browser("Input.dispatchMouseEvent", type="mouseWheel", x=left + x, y=top + y, deltaX=0,
            deltaY=-200)  # fmt: skip
    browser.value(frame)
    assert browser.value("state.scale") > scale
    browser.value("document.querySelector('#worst tr.go').click()")
    assert browser.value("state.picked") >= 0
    assert browser.complaints == []


@pytest.mark.slow
def test_the_nozzle_next_to_the_path_is_magnified_and_the_canvas_lets_the_page_scroll(
    browser: Browser, paper: Printer, tmp_path: Path
) -> None:
    path = tmp_path / "report.html"
    built(replace(paper, verified=None), sliced(), path)
    browser.screen(390, 844)
    browser.open(path)
    assert browser.value("data.strategies.map(each => each.name)") == ["none", "racking"]
    assert browser.value("data.figures.map(each => each.name)") == ["none", "shaper", "racking"]
    assert browser.value("data.figures.every((each, k, all) => !k || each.rms < all[k - 1].rms)")
    assert browser.value("data.strategies.every((each, k, all) => !k || each.rms < all[k - 1].rms)")
    assert not browser.value("document.getElementById('warnings').innerText")

    browser.value("state.strategy = 0")
    corner = browser.value("path.error[0].indexOf(Math.max(...path.error[0]))")
    apart = []
    for times in (1, 20):
        browser.value(f"magnified = $('magnified'); magnified.value = {times}; "
                      "magnified.dispatchEvent(new Event('change'))")  # fmt: skip
        x, y = browser.value(f"nozzle({corner})")
        near_x, near_y = min(max(x, 100.0), 140.0), min(max(y, 100.0), 130.0)
        apart.append(float(np.hypot(x - near_x, y - near_y)))
    assert apart[1] == pytest.approx(20.0 * apart[0], abs=0.2)
    assert apart[1] > 0.5

    top = browser.value("canvas.scrollIntoView({block: 'center'}), scrollY")
    left, upper, width, height = browser.value(BOX)
    browser.swipe_up(left + width / 2, upper + height / 2, 200.0)
    settled = "new Promise(done => setTimeout(() => done(scrollY), 300))"
    assert browser.value(settled) > top + 100
    assert browser.complaints == []


@pytest.mark.slow
def test_it_fits_phones_and_desks_by_day_and_by_night(
    browser: Browser, paper: Printer, tmp_path: Path, artefacts: Path
) -> None:
    """Text and lines stand out, no column is cut, and pictures are kept to be looked at."""
    path = tmp_path / "report.html"
    built(paper, (SAMPLES / "rectangle.gcode").read_bytes(), path, "rectangle.gcode")
    pictures = {}
    for name, width, height in (("phone", 390, 844), ("desk", 1280, 900)):
        for dark in (False, True):
            browser.screen(width, height, dark)
            browser.open(path)
            check_readable(browser, width)
            shades = browser.value(f"({RATIOS})(Array.from({{length: COLOURS}}, (_, k) => "
                                   "[colour(k), style('--stage')]))")  # fmt: skip
            assert min(shades) >= 3.0
            picture = artefacts / f"report-{name}-{'dark' if dark else 'light'}.png"
            browser.shot(picture, whole=True)
            pictures[name, dark] = picture.read_bytes()
    assert all(picture.startswith(b"\x89PNG") for picture in pictures.values())
    assert len(set(pictures.values())) == 4
    assert browser.complaints == []
