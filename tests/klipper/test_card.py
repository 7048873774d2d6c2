"""Converted files that Klipper's virtual_sdcard prints, pauses, repeats, cancels, begins again."""

from pathlib import Path

import numpy as np
import pytest

from hframe_post.firmware.klipper.macros import macros
from hframe_post.printer.profile import load
from tests.conftest import few

from .head import from_card, head
from .test_excluded import SLICES, converted, converted_text, with_commands

pytestmark = pytest.mark.klipper
PARK = [5.0, 5.0]
PAUSED = ["PAUSE", "G90", f"G1 X{PARK[0]} Y{PARK[1]} F9000", "RESUME"]
SQUARE = ["G1 X60 Y30 E{:.3f}", "G1 X60 Y60 E{:.3f}", "G1 X30 Y60 E{:.3f}", "G1 X30 Y30 E{:.3f}"]


@pytest.mark.parametrize("name", few([*SLICES], 1))
def test_wherever_a_print_is_paused_it_goes_on_as_if_it_were_not(name: str, tmp_path: Path) -> None:
    text = "\n".join(with_commands(converted(name))) + "\n"
    count = text.count("\n")
    lines = np.random.default_rng(count).choice(count, 200, replace=False).tolist()
    whole = from_card(text, tmp_path)
    np.testing.assert_array_equal(whole, head(text.splitlines())[0])
    paused = from_card(text, tmp_path, dict.fromkeys(lines, PAUSED))
    parked = np.flatnonzero((paused[:, :2] == PARK).all(axis=1))
    assert len(parked) > 150  # where the head has not moved yet there is no way
    without = np.delete(paused, [*parked, *(parked + 1)], axis=0)  # and the way back
    np.testing.assert_allclose(without, whole, atol=1e-9)


@pytest.mark.parametrize("mode", ["M82", "M83"])
def test_a_loop_prints_the_same_each_time(mode: str, tmp_path: Path) -> None:
    filament = np.ones(4) if mode == "M83" else np.arange(1, 5)
    walls = [line.format(e) for line, e in zip(SQUARE, filament, strict=True)]
    body = ["G92 E0", "G1 X30 Y30 F9000", "G91", "G1 Z.2", "G90", *walls, "G1 E{:.3f} F1800"]
    body[-1] = body[-1].format(-1.0 if mode == "M83" else 3.0)
    loop = ["SDCARD_LOOP_BEGIN COUNT=5", *body, "SDCARD_LOOP_END"]
    lines = ["G28", "G90", mode, "G1 X10 Y10 Z.2 F9000", *loop, "G1 X10 Y100"]
    sliced = from_card("\n".join([*lines, ""]), tmp_path)
    ours = from_card(converted_text("\n".join(lines)), tmp_path)
    assert sliced[-1].tolist() == pytest.approx([10.0, 100.0, 1.2, 15.0])
    np.testing.assert_allclose(ours[-1], sliced[-1], atol=1e-4)
    for corner in sliced[1:]:  # each of which is visited in each layer
        there = np.abs(ours[:, :3] - corner[:3]).max(axis=1) < 1.0  # the command leads
        assert there.any(), corner


@pytest.mark.parametrize("cancelled", [300, 1500])
def test_a_cancelled_print_leaves_nothing_to_the_next(cancelled: int, tmp_path: Path) -> None:
    """Nor to a file as sliced that does not say that its E is absolute, as after a restart."""
    sliced = SLICES["PrusaSlicer's comments"].replace("M82\n", "")
    (tmp_path / "next.gcode").write_text(sliced + "\n")
    wrapper = macros(load("paper")).partition("[gcode_macro cANCEL_PRINT]")[2].partition("[")[0]
    typed = [line.strip() for line in wrapper.splitlines() if "_HFRAME" not in line]
    console = ["CANCEL_PRINT", *typed, "SDCARD_RESET_FILE", "SDCARD_PRINT_FILE FILENAME=next.gcode"]
    whole = head(sliced.splitlines())[0]
    after = from_card(converted_text(sliced), tmp_path, {cancelled: console})[-len(whole) :]
    np.testing.assert_allclose(after[1:, :3], whole[1:, :3], atol=1e-9)
    np.testing.assert_allclose(np.diff(after[:, 3]), np.diff(whole[:, 3]), atol=1e-9)
