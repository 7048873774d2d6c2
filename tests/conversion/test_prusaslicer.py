"""Settings of the real PrusaSlicer (Debian's prusa-slicer), where it is installed."""

import shlex
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.errors import GcodeError
from hframe_post.printer.profile import load
from tests.conversion.slice_tools import carried, converted, filament
from tests.quantities import below
from tests.slices import Slice

SLICER = shutil.which("prusa-slicer")
BASE = "--center 150,100 --layer-height 0.3 --skirts 0 --start-gcode G28"
MULTI = (
    "--nozzle-diameter 0.4,0.4 --filament-diameter 1.75,1.75 --temperature 200,200 "
    "--first-layer-temperature 200,200 --single-extruder-multi-material --infill-extruder 2 "
    "--use-relative-e-distances"
)
VASE = "--spiral-vase --perimeters 1 --fill-density 0 --top-solid-layers 0"
TOWER = "--wipe-tower --wipe-tower-x 190 --wipe-tower-y 80"
GEOMETRY = (
    "--brim-width 3 --skirts 2 --raft-layers 2 --support-material --fuzzy-skin external --ironing "
    "--fill-pattern gyroid --infill-first --thin-walls --gcode-resolution 0.1"
)
SETTINGS = [
    "--gcode-flavor marlin", "--gcode-flavor reprapfirmware", "--gcode-flavor sailfish",
    "--gcode-flavor smoothie --gcode-comments", "--use-relative-e-distances --use-volumetric-e",
    "--use-relative-e-distances --layer-gcode ;L[layer_num] --use-firmware-retraction", VASE,
    "--retract-lift 0.4 --retract-layer-change --wipe --retract-before-wipe 50%",
    "--complete-objects --retract-restart-extra 0.05", GEOMETRY, f"{MULTI} {TOWER} --wipe",
    "--gcode-label-objects --use-relative-e-distances", "--retract-length 0 --end-gcode M84",
    "--gcode-flavor marlin2 --remaining-times --silent-mode --machine-limits-usage emit_to_gcode",
    "--default-acceleration 2000 --perimeter-acceleration 800 --infill-acceleration 1500",
    f"{MULTI} {TOWER} --gcode-flavor marlin --layer-gcode 'G92 E0'",
]  # fmt: skip
FACES = (
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6),
    (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
)  # fmt: skip

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(SLICER is None, reason="prusa-slicer is not installed: make programs"),
]


def brick(path: Path) -> None:
    """14 × 10 × 1.5 mm as STL."""
    corners = [(14 * a, 10 * b, 1.5 * c) for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    lines = ["solid brick"]
    for face in FACES:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x} {y} {z}" for x, y, z in (corners[k] for k in face)]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid brick"]))


def check(settings: str, folder: Path) -> None:
    brick(folder / "brick.stl")
    asked = [str(SLICER), "--export-gcode", "brick.stl", "-o", "brick.gcode"]
    subprocess.run(
        [*asked, *BASE.split(), *shlex.split(settings)], cwd=folder, check=True, capture_output=True
    )
    each = Slice("brick", harmless=("M101", "M103"), folder=folder)
    source = [line.rstrip(b"\r\n") for line in each.lines]
    marlin = "marlin" in settings
    printer = load("paper-marlin" if marlin else "paper")
    high = replace(printer.limits, z_velocity=10.0, z_acceleration=500.0)
    output, _, report = converted(each, replace(printer, limits=high))
    before, after = filament(source, False), filament(output, False)
    assert len(before) == len(after) > 3
    # Marlin's segments end where six steps have been made, not where a line is carried
    np.testing.assert_allclose(after, before, atol=0.03 if marlin else 1e-3)
    assert carried(output) == carried(source)
    below(report.path.extrusion_share, 0.005, "share of the extrusion that is not compensated")


@pytest.mark.parametrize("flavor", ["mach3", "machinekit"])
def test_filament_on_an_axis_of_its_own_is_refused(flavor: str, tmp_path: Path) -> None:
    with pytest.raises(GcodeError, match="unexpected word A"):
        check(f"--gcode-flavor {flavor}", tmp_path)


@pytest.mark.parametrize("settings", SETTINGS)
def test_each_setting(settings: str, tmp_path: Path) -> None:
    check(settings, tmp_path)
