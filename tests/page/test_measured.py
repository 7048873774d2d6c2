"""The page of measurements, in a real browser: values appear where the pointer is."""

from pathlib import Path

import numpy as np
import pytest

from hframe_post.page.charts import MOST_POINTS, Card, Chart, Curve, Section, page
from tests.chromium import Browser
from tests.page.pages import check_readable, data_of

EVIL = "</script><script>window.evil=1</script>"
HZ = np.geomspace(3.0, 100.0, 5000)


def built(name: str = "my printer") -> bytes:
    resonance = Curve("x = 80 mm", HZ, 1.0 / np.abs(1.0 - (HZ / 30.0) ** 2 + 0.1j * HZ / 30.0))
    gap = Curve(name, np.arange(4.0), np.array([1.0, np.nan, 3.0, 4.0]), "var(--ink)", strong=True)
    marks = [(29.0, "29 Hz"), (30.0, name), (200.0, "not shown")]
    charts = [
        Chart("Magnitude", "frequency, Hz", "1", [resonance], (True, True), marks),
        Chart(name, "time, s", "mm", [gap], (False, False)),
    ]
    cards = [Card("off by", "3", "%", "order 4", "bad")]
    return page(name, "It helps.", cards, [Section("Gxx", charts)],
                [f"WARNING          {name}"], [("data", name)])  # fmt: skip


def test_lines_are_thinned_and_keep_their_gaps() -> None:
    first, second = data_of(built())["sections"][0]["charts"]
    (line,) = first["lines"]
    assert MOST_POINTS / 2 < len(line["at"]) <= MOST_POINTS
    assert line["at"][0] == 3.0
    assert line["at"][-1] == 100.0
    assert second["lines"][0]["y"] == [1.0, None, 3.0, 4.0]


@pytest.mark.slow
def test_charts_show_values_and_text_is_never_markup(browser: Browser, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_bytes(built(EVIL))
    for width in (1280, 390):
        browser.screen(width, 844, dark=width < 600)
        browser.open(path)
        assert browser.value("document.querySelectorAll('.plot svg path').length") == 2
        check_readable(browser, width)
        browser.screen(width, 844, dark=width >= 600)
        check_readable(browser, width)
        assert browser.value("document.getElementById('warnings').textContent") == EVIL
    assert browser.value("window.evil") is None
    marks = "[...document.querySelectorAll('text.mark')].map((mark) => mark.%s)"
    assert browser.value(marks % "textContent") == ["29 Hz", EVIL]
    rows = browser.value(marks % "getAttribute('y')")
    assert rows[0] != rows[1]  # they would overlap
    gap = "document.querySelectorAll('.plot svg path')[1].getAttribute('d').match(/M/g).length"
    assert browser.value(gap) == 2
    key = "document.querySelector('.key').textContent"
    assert browser.value(key) == "x = 80 mm"
    at = browser.value("(({x, y, width}) => [x + 52 + (width - 64) * Math.log(30 / 3) / "
                       "Math.log(100 / 3), y + 50])(document.querySelector('.plot svg')"
                       ".getBoundingClientRect())")  # fmt: skip
    browser("Input.dispatchMouseEvent", type="mouseMoved", x=at[0], y=at[1])
    shown = browser.value(key)
    assert shown.startswith("30")
    assert 9.0 <= float(shown.rsplit(" ", 1)[1]) <= 10.1  # the resonance
    assert browser.complaints == []
