"""RepRapFirmware by its documentation: commands, trapezoids, modes. It was never run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hframe_post.errors import PrinterError
from hframe_post.firmware.player import Dwelling
from hframe_post.firmware.registry import player
from hframe_post.firmware.reprapfirmware import RepRapFirmware
from hframe_post.gcode.commands import dialect
from hframe_post.gcode.coordinates import Coordinates
from hframe_post.printer.profile import load, parse
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import ModalState
from tests.conversion.test_pipeline import assert_same_stream, converted, layers, sample

NOWHERE = (0.0, 0.0, 0.0)
AT = np.array([12.5, 30.0, 0.2, 7.0])
DUET = """
extends = "paper"
[firmware]
dialect = "reprapfirmware"
[firmware.reprapfirmware]
max_velocity = [300.0, 300.0]
max_acceleration = [10000.0, 10000.0]
acceleration = 3000.0
travel_acceleration = 5000.0
jerk = [10.0, 10.0]
jerk_e = 5.0
pressure_advance = 0.04
shaper = "mzv"
shaper_freq = 42.0
"""


@pytest.fixture(scope="module")
def duet() -> Printer:
    return parse(DUET, "duet")


def machine(printer: Printer, tolerance: float | None = None) -> RepRapFirmware:
    found = player(printer, tolerance)
    assert isinstance(found, RepRapFirmware)
    return found


def test_stream_begins_unshaped_with_limits_in_its_units(duet: Printer) -> None:
    assert machine(duet).begin(NOWHERE, AT) == [
        b"M400", b'M593 P"none"', b"M572 D0 S0", b"M201 X250000 Y250000", b"M203 X46200 Y46200",
        b"M204 P250000 T250000", b"M566 X60000 Y60000", b"G90", b"M83",
    ]  # fmt: skip


def test_stream_ends_with_the_users_settings(duet: Printer) -> None:
    state = ModalState(False, True, 3.5, 100.0, NOWHERE)
    assert machine(duet).end(state, AT) == [
        b"M400", b"M201 X10000 Y10000", b"M203 X18000 Y18000", b"M204 P3000 T5000",
        b"M566 X600 Y600", b"M572 D0 S0.04", b'M593 P"mzv" F42', b"G1 F6000", b"M82",
        b"G92 E3.5", b"G91",
    ]  # fmt: skip


def test_segments_take_the_time_they_are_given(duet: Printer) -> None:
    """By trapezoids whose ends are the lower of two neighbours' speeds."""
    rng = np.random.default_rng(7)
    own, at = machine(duet), np.zeros((101, 4))
    speed = 80.0 + 40.0 * np.sin(np.arange(100) / 9.0)
    at[1:, 0] = np.cumsum(speed * 4e-3)
    at[1:, 3] = 0.03 * at[1:, 0]
    T = np.full(100, 4e-3) * rng.uniform(0.9, 1.1, 100)
    rest = np.zeros(101, dtype=bool)
    v = own.feed_rates(at, T, rest, float(speed[0]))
    np.testing.assert_allclose(own.durations(at, v, rest, float(speed[0])), T, rtol=2e-3)
    joint = np.minimum(np.append(speed[0], v[:-1]), v), np.minimum(np.append(v[1:], v[-1]), v)
    a = own.limits.extruder_acceleration / 0.03  # the filament's is the lower one
    exact = (np.diff(at[:, 0]) + ((v - joint[0]) ** 2 + (v - joint[1]) ** 2) / (2.0 * a)) / v
    np.testing.assert_allclose(exact, T, rtol=2e-3)


def test_slices_convert(duet: Printer) -> None:
    text = converted(layers("cube.gcode", 3), duet)[0]
    assert text.count(b"\nG1 ") > 500
    assert b"SET_" not in text


def test_jerk_of_the_stream_outlasts_that_of_the_file(duet: Printer) -> None:
    carried = [b"M83\n", b"G1 X100 Y100 Z1 F6000\n", b"G1 X110 E1\n", b"M566 X600 Y600\n",
               b"G1 X120 E1\n"]  # fmt: skip
    rows = converted(carried, duet)[0].splitlines()
    assert rows[rows.index(b"M566 X600 Y600") + 1] == b"M566 X60000 Y60000"


@pytest.mark.parametrize(
    ("name", "expected"), [("reprapfirmware", 7.0), ("marlin", 12.0), ("klipper", 12.0)]
)
def test_g91_leaves_e_as_m82_says(name: str, expected: float) -> None:
    """Marlin and Klipper take E from G91; here it stays absolute."""
    where = Coordinates(dialect(name))
    where.position = (0.0, 0.0, 0.0, 5.0)
    where.set_mode("M82")
    where.set_mode("G91")
    assert where.target(None, None, None, 7.0)[3] == expected


def test_standstill_is_a_dwell(duet: Printer) -> None:
    assert machine(duet).dwell(0.0123, Dwelling.MOTION) == (b"G4 P12\n", 0.012)
    assert machine(duet).dwell(0.0, Dwelling.MOTION) is None
    assert machine(duet).dwell(0.0, Dwelling.BEFORE_LIFT) == (b"G4 P0\n", 0.0)


def test_profile_without_its_table_is_refused() -> None:
    paper = load("paper")
    other = replace(paper, firmware=replace(paper.firmware, dialect="reprapfirmware"))
    with pytest.raises(PrinterError, match=r"firmware\.reprapfirmware"):
        player(other, None)


def test_golden_rectangle(duet: Printer, golden: Callable[[str, bytes], bytes]) -> None:
    now = converted(sample("rectangle.gcode"), duet)[0].partition(b"\n")[2]
    assert_same_stream(now, golden("rectangle.reprapfirmware.gcode", now))
