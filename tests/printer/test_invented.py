"""Profiles with an unmeasured plant: nothing is compensated until the printer is measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hframe_post as hp
from hframe_post.errors import PrinterError
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.firmware.klipper.settings import from_klipper
from hframe_post.model.kinematics import TYPES
from hframe_post.printer.profile import load, parse, shipped
from hframe_post.printer.setup import Known, profile_text
from tests.command_line import RECTANGLE, run
from tests.printers import REAL
from tests.profiles import with_plant

STARTS = ("example-voron", "example-ender", "example-hbot")


@pytest.mark.parametrize("name", shipped())
def test_no_shipped_plant_and_no_copy_of_one_is_the_users(name: str) -> None:
    assert load(name).invented
    copied = run("printers", "show", name).stdout.decode()
    assert parse(copied, "copy").invented
    assert parse(f'extends = "{name}"\n', "own").invented


def test_a_plant_of_unknown_origin_is_not_measured_until_its_profile_says_so() -> None:
    unknown = shipped()["paper"]
    assert parse(unknown, "old copy").invented
    assert not parse(unknown.replace("[plant]", "[plant]\ninvented = false"), "typed").invented


def test_the_papers_printer_is_shown_where_it_is_asked_for_by_name_and_never_in_place(
    tmp_path: Path,
) -> None:
    out, part = tmp_path / "out.gcode", tmp_path / "part.gcode"
    part.write_bytes(RECTANGLE.read_bytes())
    asked = run(part, "-o", out, "-p", "paper")
    assert asked.returncode == 0
    warning = "WARNING          not your printer"
    assert asked.stderr.decode().startswith(warning)
    summary = [line for line in out.read_text().splitlines() if line.startswith("; hframe-post: ")]
    assert summary[0].startswith(f"; hframe-post: {warning}")
    for refused in (
        run(part, "-p", "paper"),  # as a slicer's hook does
        run(part, "-o", out, "-p", "paper", SLIC3R_PP_OUTPUT_NAME="part.gcode"),
        run(part, "-o", out, HFRAME_PRINTER="paper"),
        run("batch", part, "-d", tmp_path / "many", "-p", "paper"),
        run("verify", "-p", "paper", "--gcode", out),
    ):
        assert refused.returncode == 1
        assert b"this plant was not measured on your printer" in refused.stderr
    assert part.read_bytes() == RECTANGLE.read_bytes()
    with pytest.raises(PrinterError, match="was not measured"):
        hp.convert(part, out, load("paper"))


@pytest.mark.parametrize("name", STARTS)
def test_a_start_is_refused_until_it_is_identified(name: str, tmp_path: Path) -> None:
    out = tmp_path / "out.gcode"
    printer = load(name)
    with pytest.raises(PrinterError, match=r"plant\.invented.*identify recordings"):
        hp.convert(RECTANGLE, out, printer)
    assert not out.exists()
    own = tmp_path / "own.toml"
    own.write_text(with_plant(name, printer.plant, printer.compensation.windows, ["measured"]))
    assert not load(str(own)).invented
    mine = parse(own.read_text() + "\n", "own").plant
    np.testing.assert_allclose(mine.Gxx.deviation, printer.plant.Gxx.deviation, atol=1e-4)


def test_command_line_refuses_says_what_to_do_and_can_be_overruled(tmp_path: Path) -> None:
    out, folder = tmp_path / "out.gcode", tmp_path / "many"
    line = (RECTANGLE, "-o", out, "-p", "example-corexy")
    for refused in (run(*line), run("batch", RECTANGLE, "-d", folder, "-p", "example-corexy"),
                    run("verify", "-p", "example-corexy", "--gcode", out)):  # fmt: skip
        assert refused.returncode == 1
        assert b"plant.invented: this plant was not measured on your printer" in refused.stderr
        advice = (
            b"TEST_RESONANCES with an accelerometer, then type 'hframe-post identify recordings"
        )
        assert advice in refused.stderr
        assert b"sweep" not in refused.stderr
        assert b"--force" not in refused.stderr
    marlin = run(RECTANGLE, "-o", out, "-p", "example-ender")
    assert b"'hframe-post sweep' writes with an accelerometer" in marlin.stderr
    assert not out.exists()
    assert not folder.exists()
    assert run(*line, "-c", "none").returncode == 0
    assert run(*line, "--force").returncode == 0
    done = run("batch", RECTANGLE, "-d", folder, "-p", "example-corexy", "--force")
    assert done.returncode == 0, done.stderr
    assert run(RECTANGLE, "-n", "-p", "example-corexy").returncode == 0  # nothing is written
    assert b"[example: not measured on a printer]" in run("printers").stdout
    assert b"its plant is not measured" in run("doctor", "-p", "example-corexy").stdout


@pytest.mark.parametrize("kind", TYPES)
def test_a_new_profile_of_each_kind_is_marked_until_it_is_identified(
    kind: str, tmp_path: Path
) -> None:
    config = tmp_path / "printer.cfg"
    config.write_text(REAL.read_text().replace("corexy", "cartesian"))
    own = tmp_path / "own.toml"
    tables = from_klipper(KlipperConfig(config), kind)
    own.write_text(profile_text({"kinematics": {"type": Known(kind, "")}, **tables}, "mine"))
    printer = load(str(own))
    assert (printer.kinematics.type, printer.invented) == (kind, True)
    found = replace(load("paper").plant, Gxtheta=None)
    identified = parse(with_plant(str(own), found, printer.compensation.windows, []), "own")
    assert not identified.invented
    assert identified.compensation.strategy == "racking"


def test_identification_ends_a_profile_that_compensates_nothing(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text('extends = "paper"\n[compensation]\nstrategy = "none"  # not yet\n')
    paper = load("paper")
    own.write_text(with_plant(str(own), paper.plant, paper.compensation.windows, []))
    assert load(str(own)).compensation.strategy == "racking"


def test_mark_is_true_or_false() -> None:
    with pytest.raises(PrinterError, match=r"plant\.invented: must be true or false"):
        parse('extends = "paper"\n[plant]\ninvented = "yes"\n', "own")
