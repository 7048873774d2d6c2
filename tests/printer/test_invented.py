"""Profiles with an unmeasured plant: nothing is compensated until the printer is measured."""

from pathlib import Path

import numpy as np
import pytest

import hframe_post as hp
from hframe_post.errors import PrinterError
from hframe_post.printer.profile import load, parse, shipped
from tests.command_line import RECTANGLE, run
from tests.printers import with_plant

STARTS = ("example-voron", "example-ender", "example-hbot")


@pytest.mark.parametrize("name", shipped())
def test_no_shipped_plant_and_no_copy_of_one_is_the_users(name: str) -> None:
    assert load(name).invented
    copied = shipped()[name]
    assert parse(copied, "copy").invented
    assert parse(f'extends = "{name}"\n', "own").invented


def test_a_plant_of_unknown_origin_is_not_measured_until_its_profile_says_so() -> None:
    unknown = shipped()["paper"]
    assert parse(unknown, "old copy").invented
    assert not parse(unknown.replace("[plant]", "[plant]\ninvented = false"), "typed").invented


@pytest.mark.parametrize("name", STARTS)
def test_a_start_is_refused_until_it_is_identified(name: str, tmp_path: Path) -> None:
    out = tmp_path / "out.gcode"
    printer = load(name)
    with pytest.raises(PrinterError, match=r"not measured yet.*hframe-post measure"):
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
    for refused in (run(*line), run("batch", RECTANGLE, "-o", folder, "-p", "example-corexy"),
                    run("measure", "--for=check", "-o", out, "-p", "example-corexy")):  # fmt: skip
        assert refused.returncode == 1
        assert b": this printer is not measured yet" in refused.stderr
        assert b"'hframe-post measure -o measure.gcode'" in refused.stderr
        assert b"sweep" not in refused.stderr
        assert b"--force" not in refused.stderr
    marlin = run(RECTANGLE, "-o", out, "-p", "example-ender")
    assert b"'hframe-post calibrate-print'" in marlin.stderr
    assert not out.exists()
    assert not folder.exists()
    assert run(*line, "-c", "none").returncode == 0
    assert run(*line, "--force").returncode == 0
    done = run("batch", RECTANGLE, "-o", folder, "-p", "example-corexy", "--force")
    assert done.returncode == 0, done.stderr
    assert run(RECTANGLE, "-n", "-p", "example-corexy").returncode == 0  # nothing is written
    assert b"its resonances are not measured" in run("doctor", "-p", "example-corexy").stdout
