"""A model without a sensor: what a tower shows, the form, and squares to compare."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import find_peaks

from hframe_post.arrays import TS
from hframe_post.errors import HframeError, IdentificationError
from hframe_post.identification.by_eye import (
    Filled,
    Reading,
    corner_path,
    filled,
    form,
    printed_mode,
)
from hframe_post.identification.tower import Band, bands, squares, tower
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.printer.firmware_tables import KlipperTable, MarlinTable
from hframe_post.printer.profile import load
from tests.command_line import run
from tests.printers import ender
from tests.simulator import Axis, Machine, Mode

A = 1500.0
HEAT = (210.0, 60.0)  # °C of nozzle and bed
CORNERS = "M205 B0 S0 T0 J"  # of a board with junction deviation


@pytest.mark.parametrize(("hz", "damping"), [(20.0, 0.1), (30.0, 0.05), (45.0, 0.03), (55.0, 0.07)])
@pytest.mark.parametrize(("seen_from", "a"), [(0.01, 500.0), (0.02, 1500.0), (0.015, 10000.0)])
def test_waves_show_the_mode(hz: float, damping: float, seen_from: float, a: float) -> None:
    """However small the waves are that an owner sees, and in the ramp behind a corner, too."""
    its = [read(hz, damping, band, a, seen_from) for band in bands(ender(a))]
    found = printed_mode(its, a)
    assert found.hz == pytest.approx(hz, rel=0.03)
    assert found.damping == pytest.approx(damping, rel=0.4)
    assert found.uncertainty < 0.1


def test_a_wave_too_many_hardly_counts_and_is_shown() -> None:
    one, two, *more = (read(30.0, 0.05, band, A) for band in bands(ender()))
    sheet = Filled(
        {"x": [one, replace(two, waves=two.waves + 1), *more], "y": [one, two, *more]}, A
    )
    modes = sheet.modes()
    assert modes["x"].hz == pytest.approx(30.0, rel=0.03)
    (found,) = sheet.doubts(modes, bed_moves=True)
    assert "row x2 means" in found
    assert "count its waves again" in found


def test_crests_counted_as_waves_in_every_row_are_shown() -> None:
    """All rows agree then, on a frequency that is too high."""
    rows = [read(30.0, 0.05, band, A) for band in bands(ender())]
    crests = [replace(one, waves=one.waves + 1.0) for one in rows]
    sheet = Filled({"x": crests, "y": rows}, A)
    found = list(sheet.doubts(sheet.modes(), bed_moves=False))
    assert len(found) == len(crests)
    assert all(f"row x{k} " in one for k, one in enumerate(found, 1))
    assert any("did you count crests?" in one for one in found)


def test_readings_that_disagree_are_uncertain() -> None:
    one, two, *more = (read(30.0, 0.05, band, A) for band in bands(ender()))
    found = printed_mode([one, replace(two, distance=1.5 * two.distance), *more], A)
    assert found.uncertainty > 0.1


def test_a_bed_that_rings_faster_than_the_head_is_shown_for_a_look() -> None:
    slow, fast = ([read(hz, 0.05, band, A) for band in bands(ender())] for hz in (30.0, 50.0))
    for x, y, doubted in ((slow, fast, True), (fast, slow, False)):
        sheet = Filled({"x": x, "y": y}, A)
        found = list(sheet.doubts(sheet.modes(), bed_moves=True))
        assert any("exchange" in doubt for doubt in found) == bool(found) == doubted


def test_modes_answer_straight_lines_exactly() -> None:
    """But for what is left once they have settled."""
    hz = np.geomspace(1.0, 100.0, 50)
    s = 2j * np.pi * (hz[:, None] + np.arange(-50, 51) / TS)  # and the images of the samples
    lines = (2.0 * np.sin(np.pi * hz[:, None] * TS) / (np.abs(s) * TS)) ** 2
    s /= 2.0 * np.pi * 40.0
    axis, wanted = (
        ImpulseResponse.from_mode(40.0, 0.05),
        (lines / (s * s + 0.1 * s + 1.0)).sum(axis=1),
    )
    off = np.abs(axis.response(2.0 * np.pi * hz * TS) - wanted)
    assert off.max() < 2e-3 * np.abs(wanted).max()
    assert axis.lag == pytest.approx(0.1 / (2.0 * np.pi * 40.0 * TS))
    assert axis.ahead == 0


def test_impossible_readings_are_errors() -> None:
    band = Band(100.0, 20.0)
    with pytest.raises(IdentificationError, match="no row has a distance"):
        printed_mode([Reading(band, 0.0, 0.0, 0.0)], A)
    with pytest.raises(IdentificationError, match="over all of the waves that you counted"):
        printed_mode([Reading(band, 1.0, 5.0, 6.0)], A)


def test_a_form_is_read_as_it_was_written() -> None:
    empty = form(bands(ender()), A)
    text = empty.replace("y2 = [0, 0, 0]", "y2 = [9.5, 4, 5.5]")
    found = filled(text, "a.toml")
    assert found.acceleration == A
    assert [one.band for one in found.readings["x"]] == bands(ender())
    assert found.readings["y"][1] == Reading(bands(ender())[1], 9.5, 4.0, 5.5)
    with pytest.raises(IdentificationError, match="x, right wall: no row"):
        found.modes()
    for row, message in (
        *((row, "x1 must be three numbers. A row reads like x1 = ")
          for row in ('[1, "4", 2]', "[1, 4]", "[1, -4, 2]", "[1, 4, 1e5]", "4", "[9,5, 4, 5]")),
        ("[9.5mm, 4, 5]", "A row reads like x1 = "),
        ("[0, 4, 5]", "x1 has a distance without waves"),
        ("[9.5, 0, 5]", "x1 has a distance without waves"),
    ):  # fmt: skip
        with pytest.raises(HframeError, match=re.escape(message)):
            filled(empty.replace("x1 = [0, 0, 0]", f"x1 = {row}"), "a.toml")
    for text in ("[limits]\nspeed = 3\n", "[[waves]]\n"):
        with pytest.raises(HframeError, match="is not a form"):
            filled(text, "a.toml")


# ---------------------------------------------------------------------- prints


def lowered(lines: list[str]) -> list[tuple[float, float]]:
    """Return where (x, y) the nozzle goes down, and check that nothing is printed there."""
    x = y = z = 0.0
    boxes, ends, box = [], list[tuple[float, float]](), list[tuple[float, float]]()
    for line in lines:
        words = {w[0]: float(w[1:]) for w in line.split()[1:] if w[0] in "XYZE"}
        if not line.startswith(("G0 ", "G1 ")):
            continue
        if box and words.get("Z", z) < z - 0.5:
            ends.append((x, y))
            boxes.append((np.min(box, axis=0), np.max(box, axis=0)))
            assert not any((low <= (x, y)).all() and ((x, y) <= high).all() for low, high in boxes)
            box = []
        x, y, z = (words.get(name, at) for name, at in zip("XYZ", (x, y, z), strict=True))
        if "E" in words:
            box.append((x, y))
    return ends


def test_the_nozzle_goes_down_next_to_what_is_printed() -> None:
    assert not lowered(tower(load("example-hbot"), HEAT))
    printer = load("paper")
    pieces = squares(printer, [printer.plant] * 2, HEAT)
    assert len(lowered(b"".join(pieces).decode().splitlines())) == 1


@pytest.mark.parametrize("profile", ["example-ender", "example-voron", "example-hbot"])
def test_the_tower_stays_on_the_bed_and_restores_the_limits(profile: str) -> None:
    printer = load(profile)
    lines = tower(printer, (215.0, 60.0))
    x = [float(w[1:]) for line in lines for w in line.split() if w[0] == "X" and line[0] == "G"]
    assert printer.travel.x[0] < min(x) < max(x) < printer.travel.x[1]
    assert "M109 S215" in lines
    assert lines[0] == "; hframe-post: off"
    if printer.firmware.dialect == "klipper":
        own = printer.firmware.own(KlipperTable).acceleration
        assert any(f"ACCEL={own:g} " in line for line in lines[-9:])
    else:
        own = printer.firmware.own(MarlinTable).acceleration
        assert any(line.startswith(f"M204 P{own:g} ") for line in lines[-11:])
    assert "M82" in lines[-5:]  # as a printer counts filament after it was switched on


def test_a_mesh_that_m503_shows_is_used() -> None:
    lines = tower(ender(bed_levelling=True), HEAT)
    assert lines[lines.index("G28") + 1] == "M420 S1"
    assert "M420 S1" not in tower(ender(), HEAT)


def test_marlin_takes_hard_corners_at_the_speed_that_is_assumed() -> None:
    """20² = 2.414·J·1500: the junction's speed by Marlin's rule."""
    printer = ender()
    assert [band.speed for band in bands(printer)] == [60.0, 100.0, 150.0, 150.0]
    hard = [line for line in tower(printer, HEAT) if line.startswith(f"{CORNERS}0.11")]
    J = [float(line.removeprefix(CORNERS)) for line in hard]
    corner = (J[0] * A * 0.5**0.5 / (1.0 - 0.5**0.5)) ** 0.5
    assert corner == pytest.approx(20.0, rel=1e-3)


@pytest.mark.parametrize("profile", ["example-ender", "paper-marlin"])
def test_marlin_takes_every_deviation(profile: str) -> None:
    """It ignores M205 J below 0.01 and above 0.3 mm."""
    lines = tower(load(profile), HEAT)
    asked = [float(line.removeprefix(CORNERS)) for line in lines if line.startswith(CORNERS)]
    assert 0.01 <= min(asked) < max(asked) <= 0.3


def written_form(own: Path) -> Path:
    """Return the form of a tower for a profile, as the owner of a 40 and 28 Hz printer fills it."""
    own.write_text('extends = "example-ender"\n[limits]\nacceleration = 1500.0\n')
    asked = run(
        "calibrate-print", "-p", own, "--heat", "210,60", "-o", own.with_name("tower.gcode")
    )
    assert asked.returncode == 0, asked.stderr
    sheet = own.with_name("tower.form.toml")
    sheet.write_text(filled_in(sheet.read_text(), {"x": 40.0, "y": 28.0}))
    return sheet


def frequencies(own: Path) -> list[float]:
    """Return the frequencies (Hz) of x and y at which the response is a quarter turn late."""
    plant, hz = load(str(own)).plant, np.arange(10.0, 80.0, 0.01)
    turned = (G.response(2.0 * np.pi * hz * TS).real for G in (plant.Gxx, plant.Gyy))
    return [float(hz[np.argmax(real < 0.0)]) for real in turned]


@pytest.mark.slow
def test_a_printer_without_a_sensor(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    sheet = written_form(own)
    done = run("calibrate-print", "-p", own, "--form", sheet, "-o", own)
    assert done.returncode == 0, done.stderr
    assert not load(str(own)).invented
    assert load(str(own)).uncertainty == 0.1
    assert frequencies(own) == pytest.approx([40.0, 28.0], rel=0.03)


@pytest.mark.slow
def test_squares_are_compared_and_the_best_is_picked(tmp_path: Path) -> None:
    own, three = tmp_path / "own.toml", tmp_path / "three.gcode"
    sheet = written_form(own)
    assert run("calibrate-print", "-p", own, "--form", sheet, "-o", own).returncode == 0
    before = frequencies(own)
    done = run("calibrate-print", "-p", own, "--compare", "6%", "--heat", "210,60", "-o", three)
    assert done.returncode == 0, done.stderr
    assert b"--pick -6% 0" in done.stderr
    assert three.read_bytes().count(b"M201 X500 Y500") == 3  # restored after each
    done = run("calibrate-print", "-p", own, "--pick", "-6%", "0", "-o", own)
    assert done.returncode == 0, done.stderr
    assert frequencies(own) == pytest.approx([0.94 * before[0], before[1]], rel=1e-3)


def test_mistakes_are_errors(tmp_path: Path) -> None:
    out = tmp_path / "a.gcode"
    for words, status, message in (
        (("--pick", "-60%", "0"), 2, b"at most 30%"),
        (("--heat", "20,60"), 2, b"nozzle and bed"),
        (("--heat", "warm"), 2, b"nozzle and bed"),
        ((), 2, b"give the temperatures of your filament"),
        (("--compare", "6%", "--pick", "0", "0"), 2, b"give one of"),
        (("--compare", "6%"), 1, b"not measured yet"),
        (("--advance", "0.04"), 2, b"--advance is gone: write extruder.advance"),
        (("--advance-lines", "0.1"), 2, b"--advance-lines is gone: slicers print"),
    ):
        done = run("calibrate-print", "-p", "example-ender", *words, "-o", out)
        assert done.returncode == status
        assert message in done.stderr
    assert not list(tmp_path.iterdir())


def read(
    hz: float, damping: float, band: Band, acceleration: float, seen_from: float = 0.015
) -> Reading:
    """Return what an owner reads who does as the form says, measures to a tenth and counts halves.

    Crests are those on one side of the wall, from the corner on, of a printer in continuous time.
    """
    path, corner = corner_path(band, acceleration)
    still = np.repeat(path[:1], 300, axis=0)
    axis = Axis((Mode(hz, damping),))
    moved = Machine(axis, axis, kinematics="cartesian").played(np.vstack([still, path]))
    across, along = moved[300 + corner :, :2].T
    half_waves, _ = find_peaks(np.abs(across))
    heights = np.abs(across[half_waves])
    crests = along[half_waves[::2]]
    seen = float((heights > seen_from).sum() / 2.0)
    waves = min(int((heights[::2] > seen_from).sum()) - 2, 5)
    if waves < 1:
        return Reading(band, 0.0, 0.0, seen)
    return Reading(band, round(float(crests[1 + waves] - crests[1]), 1), waves, seen)


def filled_in(form: str, hz: dict[str, float], damping: float = 0.06) -> str:
    """Return an empty form as filled_in in by the owner of a printer with a mode in x and in y."""
    printed = tomllib.loads(form)["print"]
    for k, (speed, corner) in enumerate(zip(printed["speeds"], printed["corners"], strict=True), 1):
        for axis, its_hz in hz.items():
            one = read(its_hz, damping, Band(speed, corner), printed["acceleration"])
            row = f"{axis}{k} = [{one.distance}, {one.waves:g}, {one.seen:g}]"
            form = form.replace(f"{axis}{k} = [0, 0, 0]", row)
    return form
