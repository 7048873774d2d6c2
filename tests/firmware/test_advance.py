"""Which lines set pressure advance, and to what."""

import pytest

from hframe_post.firmware.dialect import Advance, klipper_advance, marlin_advance
from hframe_post.firmware.registry import firmware
from hframe_post.printer.profile import load, parse, shipped


@pytest.mark.parametrize(
    ("line", "seconds", "smooth_time"),
    [
        (b"SET_PRESSURE_ADVANCE ADVANCE=0.05", 0.05, None),
        (b"set_pressure_advance extruder=extruder advance=.04 SMOOTH_TIME=0.02 ; PLA", 0.04, 0.02),
        (b"SET_PRESSURE_ADVANCE EXTRUDER=extruder1 ADVANCE=0.05", None, None),
        (b"SET_PRESSURE_ADVANCE ADVANCE=-1", None, None),
        (b"SET_PRESSURE_ADVANCE ADVANCE=soft", None, None),
        (b"; SET_PRESSURE_ADVANCE ADVANCE=0.05", None, None),
        (b"M900 K0.05", None, None),
    ],
)
def test_klipper(line: bytes, seconds: float | None, smooth_time: float | None) -> None:
    assert klipper_advance(line) == (seconds, smooth_time)


@pytest.mark.parametrize(
    ("line", "seconds"),
    [
        (b"M900 K0.05", 0.05), (b"N12 m900 k.2*71", 0.2), (b"M900 T0 K1", 1.0),
        (b"M900 T1 K1", None), (b"M900", None), (b"M900 K99", None), (b"M9001 K1", None),
        (b";M900 K1", None), (b"SET_PRESSURE_ADVANCE ADVANCE=0.05", None),
    ],
)  # fmt: skip
def test_marlin(line: bytes, seconds: float | None) -> None:
    assert marlin_advance(line) == (seconds, None)


def test_a_profile_comes_before_what_marlin_has_stored() -> None:
    text = shipped()["paper-marlin"].replace("linear_advance = 0.0 ", "linear_advance = 0.03 ")
    text = text.replace('extends = "paper"', 'extends = "paper"', 1)
    stored, own = parse(text, "stored"), parse(f"{text}\n[extruder]\nadvance = 0.07\n", "own")
    for printer, seconds in ((stored, 0.03), (own, 0.07), (load("paper-marlin"), 0.0)):
        assert firmware(printer).advance() == Advance(seconds, 0.04, marlin_advance)


def test_later_lines_replace_what_they_name() -> None:
    advance = Advance(0.05, 0.04, klipper_advance)
    advance = advance.after(b"SET_PRESSURE_ADVANCE SMOOTH_TIME=0.01")
    assert (advance.seconds, advance.smooth_time) == (0.05, 0.01)
    assert advance.after(b"G1 X1") is advance
