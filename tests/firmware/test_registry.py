"""Firmwares as objects: chosen by a name that is checked, built from a printer."""

from dataclasses import fields, replace

import pytest

from hframe_post.conversion.options import known_firmware
from hframe_post.errors import ArgumentError, HframeError, PrinterError
from hframe_post.firmware.motion import MotionRules
from hframe_post.firmware.registry import FIRMWARES, firmware
from hframe_post.printer.firmware_tables import TABLES
from hframe_post.printer.profile import load, played_by
from hframe_post.printer.settings import Printer


def test_every_firmware_has_a_table_in_profiles() -> None:
    assert tuple(FIRMWARES) == tuple(TABLES)
    assert {type(table) for table in load("paper-marlin").firmware.tables} == {*TABLES.values()}
    assert all(name == each.name for name, each in FIRMWARES.items())
    assert all(TABLES[name] is each.table for name, each in FIRMWARES.items())


def test_command_line_takes_what_is_registered() -> None:
    for name in FIRMWARES:
        assert known_firmware(name) == name
    with pytest.raises(ArgumentError, match="'reprap' is not one of klipper, marlin"):
        known_firmware("reprap")


def motion(printer: Printer, tolerance: float | None) -> MotionRules:
    return firmware(printer).motion(tolerance)


def test_lifts_pass_into_motion_only_on_klipper_and_no_faster_than_a_corner() -> None:
    paper, marlin = load("paper"), load("paper-marlin")
    corner = motion(paper, 0.014).stop_rules.lift_speed
    assert 2.0 < corner < paper.limits.square_corner_velocity
    gentle = replace(paper, limits=replace(paper.limits, square_corner_velocity=1.0))
    assert motion(gentle, 0.014).stop_rules.lift_speed == 0.0
    assert (
        motion(paper, None).stop_rules.lift_speed
        == motion(marlin, 0.014).stop_rules.lift_speed
        == 0.0
    )


def with_dialect(name: str) -> Printer:
    printer = load("paper")
    return replace(printer, firmware=replace(printer.firmware, dialect=name))


def test_unknown_firmware_is_an_error_in_the_library() -> None:
    with pytest.raises(HframeError, match="one of klipper, marlin"):
        motion(with_dialect("other"), None)
    with pytest.raises(HframeError, match=r"paper: firmware\.dialect: must be one of"):
        played_by(load("paper"), "other")


def test_firmware_without_its_table_is_an_error_in_the_library() -> None:
    with pytest.raises(PrinterError, match=r"paper: firmware\.marlin: the table is missing"):
        motion(with_dialect("marlin"), None)


@pytest.mark.parametrize("name", TABLES)
def test_every_number_of_a_firmwares_table_has_bounds(name: str) -> None:
    for member in fields(TABLES[name]):
        if "float" in str(member.type) or "int" in str(member.type):
            assert member.metadata.keys() & {"above", "least"}, member.name
            assert member.metadata.keys() & {"below", "most"}, member.name
