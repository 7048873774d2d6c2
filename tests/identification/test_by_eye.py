"""A model without a sensor: what a tower shows, the form, and squares to compare."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import find_peaks

from hframe_post.arrays import TS
from hframe_post.errors import HframeError, IdentificationError
from hframe_post.identification.by_eye.form import filled, form
from hframe_post.identification.by_eye.tower import SIDE, Heat, bands, tower
from hframe_post.identification.by_eye.waves import (
    Band,
    Reading,
    corner_path,
    mode_function,
    printed_mode,
)
from hframe_post.model.plant import Filter
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.command_line import run
from tests.marlin.planner import Build, Machine

A = 1500.0


def ender(acceleration: float = A) -> Printer:
    printer = load("example-ender")
    return replace(printer, limits=replace(printer.limits, acceleration=acceleration))


def read(hz: float, damping: float, band: Band, seen_from: float = 0.015) -> Reading:
    """Return what an owner reads who measures to a tenth and counts half waves."""
    path, corner = corner_path(band, A, SIDE)
    x = Filter(mode_function(hz, damping)).run(path[:, 0] + SIDE) - SIDE
    deviation, along = np.abs(x[corner:]), path[corner:, 1]
    peaks, _ = find_peaks(deviation)
    seen = (deviation[peaks] > seen_from).sum() / 2.0
    crests = along[peaks][along[peaks] > (band.speed**2 - band.corner**2) / (2.0 * A)]
    waves = int(min(max(seen - 1.0, 1.0), 5.0))
    return Reading(band, round(float(crests[2 * waves] - crests[0]), 1), waves, seen)


@pytest.mark.parametrize(("hz", "damping"), [(20.0, 0.1), (30.0, 0.05), (45.0, 0.03), (55.0, 0.07)])
@pytest.mark.parametrize("seen_from", [0.01, 0.02])
def test_waves_show_frequency_and_damping(hz: float, damping: float, seen_from: float) -> None:
    """However small the waves are that an owner sees."""
    found = printed_mode([read(hz, damping, b, seen_from) for b in bands(ender())], A, SIDE)
    assert found.hz == pytest.approx(hz, rel=0.03)
    assert found.damping == pytest.approx(damping, rel=0.4)
    assert found.uncertainty < 0.1


def test_readings_that_disagree_are_uncertain() -> None:
    one, two, *more = (read(30.0, 0.05, band) for band in bands(ender()))
    found = printed_mode([one, replace(two, distance=1.5 * two.distance), *more], A, SIDE)
    assert found.uncertainty > 0.1


def test_impossible_readings_are_errors() -> None:
    band = Band(100.0, 20.0)
    with pytest.raises(IdentificationError, match="no band has a distance"):
        printed_mode([Reading(band, 0.0, 0.0, 0.0)], A, SIDE)
    with pytest.raises(IdentificationError, match="these waves mean 500 Hz"):
        printed_mode([Reading(band, 1.0, 5.0, 6.0)], A, SIDE)


def test_a_form_is_read_as_it_was_written() -> None:
    empty = form(bands(ender()), A)
    text = empty.replace("y2 = [0, 0, 0]", "y2 = [9.5, 4, 5.5]")
    found = filled(text, "a.toml")
    assert found.acceleration == A
    assert [one.band for one in found.readings["x"]] == bands(ender())
    assert found.readings["y"][1] == Reading(bands(ender())[1], 9.5, 4.0, 5.5)
    with pytest.raises(IdentificationError, match="x, right wall: no band"):
        found.modes()
    with pytest.raises(HframeError, match="x1 must be three numbers"):
        filled(empty.replace("x1 = [0, 0, 0]", 'x1 = [1, "4"]'), "a.toml")
    with pytest.raises(HframeError, match="is not a form"):
        filled("[limits]\nspeed = 3\n", "a.toml")


@pytest.mark.parametrize("profile", ["example-ender", "example-voron"])
def test_the_tower_stays_on_the_bed_and_restores_the_limits(profile: str) -> None:
    printer = load(profile)
    lines = tower(printer, Heat(215.0, 60.0))
    x = [float(w[1:]) for line in lines for w in line.split() if w[0] == "X" and line[0] == "G"]
    assert printer.travel.x[0] < min(x) < max(x) < printer.travel.x[1]
    assert "M109 S215" in lines
    assert lines[0] == "; hframe-post: off"
    klipper, marlin = printer.firmware.klipper, printer.firmware.marlin
    if printer.firmware.dialect == "klipper":
        assert klipper is not None
        assert f"ACCEL={klipper.acceleration:g} " in lines[-5] + lines[-6] + lines[-4]
    else:
        assert marlin is not None
        assert any(line.startswith(f"M204 P{marlin.acceleration:g} ") for line in lines[-9:])


def test_marlin_takes_hard_corners_at_the_speed_that_is_assumed() -> None:
    printer = ender()
    board = Machine(Build(1 / 80, 1 / 400, 1 / 93, cartesian=True))
    board.read("\n".join(tower(printer, Heat(210.0, 60.0))).encode())
    assert [band.speed for band in bands(printer)] == [60.0, 100.0, 150.0, 150.0]
    assert any(line.startswith("M205 J0.11") for line in board.settings)
    # 20² = 2.414·J·1500: the junction's speed by Marlin's rule
    J = next(float(line[6:]) for line in board.settings if line.startswith("M205 J0.11"))
    corner = (J * A * 0.5**0.5 / (1.0 - 0.5**0.5)) ** 0.5
    assert corner == pytest.approx(20.0, rel=1e-3)


def written_form(own: Path) -> Path:
    """Return the form of a tower for a profile, as the owner of a 40 and 28 Hz printer fills it."""
    own.write_text('extends = "example-ender"\n[limits]\nacceleration = 1500.0\n')
    asked = run("calibrate-print", "-p", own, "-o", own.with_name("tower.gcode"))
    assert asked.returncode == 0, asked.stderr
    sheet = own.with_name("tower.form.toml")
    text = sheet.read_text()
    for axis, hz in (("x", 40.0), ("y", 28.0)):
        for k, band in enumerate(bands(ender()), 1):
            one = read(hz, 0.06, band)
            row = f"{axis}{k} = [{one.distance}, {one.waves:g}, {one.seen}]"
            text = text.replace(f"{axis}{k} = [0, 0, 0]", row)
    sheet.write_text(text)
    return sheet


def frequencies(own: Path) -> tuple[float, float]:
    plant = load(str(own)).plant
    x, y = (float(np.abs(np.log(G.poles[0]))) / (2.0 * np.pi * TS) for G in (plant.Gxx, plant.Gyy))
    return x, y


@pytest.mark.slow
def test_a_printer_without_a_sensor(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    sheet = written_form(own)
    done = run("calibrate-print", "-p", own, "--form", sheet, "-o", own)
    assert done.returncode == 0, done.stderr
    assert not load(str(own)).invented
    assert load(str(own)).uncertainty == 0.1
    assert frequencies(own) == pytest.approx((40.0, 28.0), rel=0.03)


@pytest.mark.slow
def test_squares_are_compared_and_the_best_is_picked(tmp_path: Path) -> None:
    own, three = tmp_path / "own.toml", tmp_path / "three.gcode"
    sheet = written_form(own)
    assert run("calibrate-print", "-p", own, "--form", sheet, "-o", own).returncode == 0
    before = frequencies(own)
    done = run("calibrate-print", "-p", own, "--compare", "6%", "-o", three)
    assert done.returncode == 0, done.stderr
    assert b"--pick -6% 0" in done.stderr
    assert three.read_bytes().count(b"M201 X500 Y500") == 3  # restored after each
    done = run("calibrate-print", "-p", own, "--pick", "-6%", "0", "-o", own)
    assert done.returncode == 0, done.stderr
    assert frequencies(own) == pytest.approx((0.94 * before[0], before[1]), rel=1e-3)


def test_mistakes_are_errors(tmp_path: Path) -> None:
    out = tmp_path / "a.gcode"
    for words, status, message in (
        (("--pick", "-60%", "0"), 2, b"at most 30%"),
        (("--heat", "20,60"), 2, b"nozzle and bed"),
        (("--compare", "6%", "--pick", "0", "0"), 2, b"give one of"),
        (("--compare", "6%"), 1, b"not measured on your printer"),
    ):
        done = run("calibrate-print", "-p", "example-ender", *words, "-o", out)
        assert done.returncode == status
        assert message in done.stderr
    assert not list(tmp_path.iterdir())
