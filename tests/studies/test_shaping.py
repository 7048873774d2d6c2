"""The best input shaper for a printer: better than none, and than a rule of thumb."""

import configparser
import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain
from hframe_post.conversion.sliced_errors import SHAPED_PIECES, SlicedFile
from hframe_post.firmware.registry import FIRMWARES, Klipper
from hframe_post.model.shapers import AxisShaping, Shaping, most_damping
from hframe_post.prediction.best_shaper import Paths, error, guess, quadratic_form, ranked
from hframe_post.prediction.statistics import ContourErrors, ErrorStatistics
from hframe_post.printer.settings import Printer
from hframe_post.studies.shaping import ShaperComparison, comparison_as_text
from hframe_post.studies.tuning import rectangle
from tests.command_line import run
from tests.conftest import SAMPLES


def paths(lines: Iterable[bytes], printer: Printer) -> Paths:
    """Pieces of the firmware's own motion."""
    return SlicedFile.from_items(Chain(printer, Options("none")).read(lines), printer).paths


@pytest.fixture(scope="module")
def corner(paper: Printer) -> Paths:
    return paths(rectangle(paper), paper)


def test_pieces_of_a_slice_are_from_all_over_it(paper: Printer) -> None:
    none = Shaping(AxisShaping("zv", 1e5, 0.0), AxisShaping("zv", 1e5, 0.0))
    with (SAMPLES / "cube.gcode").open("rb") as cube:
        pieces = paths(cube, paper)
    assert SHAPED_PIECES <= len(pieces) < 2 * SHAPED_PIECES
    assert error(paper.plant, none, pieces).rms > 0.05


def test_the_best_shaper_halves_the_error(paper: Printer, corner: Paths) -> None:
    none = Shaping(AxisShaping("zv", 1e5, 0.0), AxisShaping("zv", 1e5, 0.0))
    bare = error(paper.plant, none, corner).rms
    (found,) = ranked(paper.plant, corner, ["mzv"])
    assert found.rms < 0.5 * bare
    assert found.rms == error(paper.plant, found, corner).rms


@pytest.mark.parametrize("name", ["ei", "2hump_ei", "3hump_ei"])
def test_no_setting_is_damped_too_much(paper: Printer, corner: Paths, name: str) -> None:
    """Since October 2025 Klipper refuses to start with more."""
    found = guess(quadratic_form(paper.plant, corner), name)
    section = configparser.ConfigParser()
    section.read_string(FIRMWARES["klipper"].shaper_settings(found))
    for axis in "xy":
        assert section.getfloat("input_shaper", f"damping_ratio_{axis}") <= most_damping(name)


def compared(*shapings: Shaping) -> list[ShaperComparison]:
    """Comparisons as of a print; their errors are those of the shapings."""
    found = []
    for each in shapings:
        errors = ContourErrors()
        errors.all.add(np.array([each.rms]))
        found.append(ShaperComparison(each.x.name, each, errors, ErrorStatistics(), 1.0))
    return found


def test_a_shaper_that_needs_a_newer_klipper_is_a_comment() -> None:
    known, newer = (
        Shaping(each, each, rms)
        for each, rms in (
            (AxisShaping("mzv", 40.0, 0.1), 0.05),
            (AxisShaping("mzv(n=5,t=1.1)", 40.0, 0.1), 0.04),
        )
    )
    klipper = FIRMWARES["klipper"]
    text = comparison_as_text(compared(newer, known), klipper)
    section = configparser.ConfigParser(comment_prefixes="#")
    section.read_string(text[text.index("[input_shaper]") :])
    assert section["input_shaper"]["shaper_type_x"] == "mzv"
    assert "# 40.0 µm, on Klipper of 27 April 2026 or newer only:" in text
    assert "# shaper_type_x: mzv(n=5,t=1.1)" in text
    near = compared(newer, replace(known, rms=0.041))
    assert "newer" not in comparison_as_text(near, klipper)


@pytest.mark.slow
def test_simulate_compares_input_shapers(tmp_path: Path) -> None:
    out = tmp_path / "s.json"
    done = run("simulate", "--shapers", "--json", out)
    assert done.returncode == 0
    report = json.loads(out.read_text())
    compared = report["against"]
    rms = {each["name"]: each["contour_error_um"]["rms"] for each in compared}
    for name, predicted in report["contour_error_um"].items():  # the lines count in both tables
        assert rms[name] == predicted["rms"]
    assert list(rms.values()) == sorted(rms.values())
    assert set(list(rms)[:2]) == {"racking", "live"}  # the same model in both
    for name in Klipper.shapers:  # searched on this very path
        assert rms[name] < rms["none"]
    times = {each["name"]: each["print_time_s"] for each in compared}
    assert times["none"] <= min(times.values())


@pytest.mark.slow
def test_a_printer_with_marlin_is_not_offered_live(tmp_path: Path) -> None:
    out = tmp_path / "s.json"
    assert run("simulate", "--shapers", "-p", "example-ender", "--json", out).returncode == 0
    assert "live" not in {each["name"] for each in json.loads(out.read_text())["against"]}


@pytest.mark.parametrize(
    ("name", "shown"), [("klipper", "shaper_type_x: mzv"), ("marlin", "M593 X F40.0 D0.100")]
)
def test_the_settings_are_those_of_the_firmware(name: str, shown: str) -> None:
    mzv, zv = (Shaping(each, each) for each in (AxisShaping(n, 40.0, 0.1) for n in ("mzv", "zv")))
    assert shown in comparison_as_text(compared(mzv, zv), FIRMWARES[name])
