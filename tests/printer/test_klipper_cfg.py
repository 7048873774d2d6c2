"""A printer.cfg is read as Klipper reads it, and compared with a profile."""

from dataclasses import replace
from pathlib import Path

import pytest

from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.firmware.klipper.source import KlipperSource, check_stream
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.printer.new_profile import Finding
from hframe_post.printer.settings import Extruder, Printer
from tests.printers import REAL, profile_of


@pytest.fixture(scope="module")
def own() -> Printer:
    return profile_of(KlipperConfig(REAL))


def findings(path: Path, printer: Printer) -> list[Finding]:
    differing = KlipperSource(path).differing(printer, "change it")
    return [*differing, *check_stream(KlipperConfig(path), printer)]


def wrong(path: Path, printer: Printer) -> list[str]:
    return [each.text for each in findings(path, printer) if each.wrong]


def changed(folder: Path, *changes: tuple[str, str]) -> Path:
    content = REAL.read_text()
    for old, new in changes:
        assert old in content
        content = content.replace(old, new, 1)
    path = folder / "printer.cfg"
    path.write_text(content)
    return path


def test_a_profile_made_from_it_agrees_with_it(own: Printer) -> None:
    assert wrong(REAL, own) == []
    assert own.travel.x == (0.0, 280.0)
    assert own.limits.z_velocity == 20.0
    assert own.firmware.own(KlipperTable).velocity == 500.0
    assert own.steps is not None
    assert own.steps.belt == pytest.approx(0.0206)
    assert own.invented  # its plant is not measured


def test_what_a_new_profile_leaves_out_has_its_default(tmp_path: Path) -> None:
    """Also where every key of [extruder] has: Klipper smooths the flow without an advance, too."""
    path = tmp_path / "printer.cfg"
    path.write_text("".join(
        line for line in REAL.read_text().splitlines(keepends=True)
        if not line.startswith("pressure_advance")
    ))  # fmt: skip
    profile = profile_of(KlipperConfig(path))
    assert profile.extruder == Extruder(advance=0.0, smooth_time=0.04)
    assert not wrong(path, profile)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("max_z_velocity: 20", "max_z_velocity: 10"), "limits.z_velocity: 10 (max_z_velocity of"),
        (("max_z_accel: 500", "max_z_accel=400 # slow"), "limits.z_acceleration: 400"),
        (("max_accel: 10000", "max_accel: 3000"), "klipper.acceleration: 3000"),
        (("max_velocity: 500", "max_velocity: 300"), "klipper.velocity: 300"),
        (("square_corner_velocity: 5\n", "\n"), ""),  # by default as it was
        (
            ("square_corner_velocity: 5", "square_corner_velocity: 8"),
            "klipper.square_corner_velocity: 8",
        ),
        (
            ("minimum_cruise_ratio: 0.5", "minimum_cruise_ratio: 0"),
            "firmware.klipper.minimum_cruise_ratio: 0",
        ),
        (
            ("[input_shaper]", "[input_shaper]\nshaper_freq_x: 51.5"),
            "firmware.klipper.shaper_freq_x: 51.5",
        ),
        (("kinematics: corexy", "kinematics: cartesian"), "kinematics of [printer]: cartesian"),
        (("position_max: 280", "position_max: 270"), "travel.x: [0, 270]"),
        (("microsteps: 16", "microsteps: 32"), "[steps]: the printer has none"),
    ],
)
def test_differences(own: Printer, tmp_path: Path, change: tuple[str, str], message: str) -> None:
    found = wrong(changed(tmp_path, change), own)
    assert len(found) == (1 if message else 0)
    assert message in "".join(found)


def test_macros_that_the_profile_names_must_be_there(own: Printer, tmp_path: Path) -> None:
    table = replace(own.firmware.own(KlipperTable), end_macro="_OWN_END")
    named = replace(own, firmware=replace(own.firmware, tables=(table,)))
    assert len(wrong(REAL, named)) == 1
    assert not wrong(REAL, own)  # _HFRAME_END is of hframe.cfg: see `check_macros`
    macros = "[gcode_macro _own_end]\ngcode:\n  G4 P1\n\n  M400\n[gcode_macro _HFRAME_END]\n"
    path = changed(tmp_path, ("[fan]", macros + "gcode: M400\n[fan]"))
    assert wrong(path, named) == []


def test_includes_and_what_klipper_saved_are_read(own: Printer, tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "limits.cfg").write_text("[printer]\nmax_accel: 4000\n")
    saved = "#*# <---- SAVE_CONFIG ---->\n#*# [input_shaper]\n#*# shaper_freq_y = 40\n"
    path = changed(tmp_path)
    lines = "[include parts/*.cfg]\n[include mainsail.cfg]\n"
    path.write_text(path.read_text() + lines + saved)
    source = KlipperSource(path)
    limits = f"{tmp_path / 'parts' / 'limits.cfg'}:2: firmware.klipper.acceleration: 4000"
    differing = wrong(path, own)
    assert [each.startswith(limits) for each in differing] == [True, False]
    last = f"{path}:{len(path.read_text().splitlines())}"
    assert any(f"{last}: firmware.klipper.shaper_freq_y: 40" in each for each in differing)
    assert any("mainsail.cfg" in each for each in source.warnings)
