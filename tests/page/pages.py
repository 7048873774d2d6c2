"""What a page carries, and whether it can be read."""

import json
import re
from pathlib import Path
from typing import Any

from tests.chromium import Browser

RATIOS = """(pairs) => {  // contrast of each pair of colours, as WCAG defines it
  const ink = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
  const luminance = (colour) => {
    ink.clearRect(0, 0, 1, 1); ink.fillStyle = colour; ink.fillRect(0, 0, 1, 1);
    const parts = [...ink.getImageData(0, 0, 1, 1).data].slice(0, 3).map((byte) => byte / 255);
    const [r, g, b] = parts.map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  return pairs.map((pair) => {
    const [low, high] = pair.map(luminance).sort((a, b) => a - b);
    return (high + 0.05) / (low + 0.05);
  });
}"""
COLOURS = """[...document.querySelectorAll('body *')].filter((one) => one.checkVisibility() &&
  [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim())).map((one) => {
    let behind = one;
    const ground = () => getComputedStyle(behind).backgroundColor;
    while (ground() === 'rgba(0, 0, 0, 0)' && behind.parentElement) behind = behind.parentElement;
    const its = getComputedStyle(one);
    return [one instanceof SVGElement ? its.fill : its.color, ground()];
  })"""
LINES = """[...document.querySelectorAll('.plot path')].map((line) =>
  [getComputedStyle(line).stroke, getComputedStyle(line.closest('.panel')).backgroundColor])"""


def data_of(html: bytes | Path) -> dict[str, Any]:
    """The data of a page, or of its file."""
    content = html.read_bytes() if isinstance(html, Path) else html
    found = re.search(rb'id="data">(.*?)</script>', content, re.DOTALL)
    assert found is not None
    printed: dict[str, Any] = json.loads(found[1])
    return printed


def check_readable(browser: Browser, width: int) -> None:
    """Check that the open page is not wider than the screen, and its text and lines stand out."""
    assert browser.value("document.documentElement.scrollWidth") <= width
    cut = "[...document.querySelectorAll('.scroll')].filter(b => b.scrollWidth > b.clientWidth)"
    assert browser.value(f"{cut}.length") == 0
    assert min(browser.value(f"({RATIOS})({COLOURS})")) >= 4.5
    assert min(browser.value(f"({RATIOS})({LINES})"), default=21.0) >= 3.0
