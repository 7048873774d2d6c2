"""What a print has and takes as sliced, against the trapezoids of Klipper's own host."""

from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import TS
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.firmware.registry import firmware
from hframe_post.planner.sliced import AsSliced
from hframe_post.prediction.best_shaper import error
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.gcode_tools import converted, hops, layers
from tests.klipper.host import play
from tests.quantities import near

OWNERS = Path(__file__).parents[1] / "benchmarks" / "owners"
pytestmark = pytest.mark.klipper


def test_errors_as_sliced_are_those_of_klippers_motion(paper: Printer, tmp_path: Path) -> None:
    lines = layers("cube.gcode", 3)
    (tmp_path / "part.gcode").write_bytes(b"".join(lines))
    table = paper.firmware.own(KlipperTable)
    limits = {
        "max_velocity": table.velocity, "max_accel": table.acceleration,
        "square_corner_velocity": table.square_corner_velocity,
        "minimum_cruise_ratio": table.minimum_cruise_ratio,
    }  # fmt: skip
    host = play(tmp_path / "part.gcode", limits=limits, workdir=tmp_path)
    t = np.arange(host.start, host.end, TS)
    path = np.ascontiguousarray(host.position(t)[:, :2])
    fed = np.diff(host.extruded(t), prepend=0.0) > 0.0
    moving = np.abs(np.diff(path, axis=0, prepend=path[:1])).max(axis=1) > 0.0
    sliced = SlicedFile.from_items(Chain(paper, Options("none")).read(lines), paper)
    today = sliced.today()
    assert today.shaping is not None
    near(sliced.own.seconds, host.duration, 0.01 * host.duration, "print time, s")
    theirs = error(paper.plant, today.shaping, [(path, fed & moving)]).rms
    near(today.contour["shaper"].rms, theirs, 0.05 * theirs, "error with the shaper, mm")


def turns(seed: int, count: int) -> list[bytes]:
    """Return lines of all lengths and accelerations, at which a cruise ratio slows the head."""
    rng, at = np.random.default_rng(seed), np.array([140.0, 140.0])
    lines = ["G28", "M83", "G1 Z0.3 F600", "G0 X140 Y140 F9000"]
    for k in range(count):
        if k % 20 == 0:
            lines.append(f"M204 S{rng.choice([500, 3000, 5000, 12_000])}")
        at = np.clip(at + rng.normal(0.0, rng.choice([0.3, 3.0, 30.0]), 2), 20.0, 250.0)
        lines.append(f"G1 X{at[0]:.3f} Y{at[1]:.3f} E0.01 F{rng.choice([3000, 9000, 18_000])}")
    return [line.encode() + b"\n" for line in lines]


@pytest.mark.parametrize("lines", [turns(0, 400), hops(0, 40)], ids=["turns", "lifts"])
def test_it_has_klippers_cruise_ratio_and_lifts(lines: list[bytes], tmp_path: Path) -> None:
    printer, lines = load("paper"), [*lines[:1], b"G92 X0 Y0 Z0\n", *lines[1:]]
    own = AsSliced(firmware(printer).limits())
    for item in [*Chain(printer, Options("racking").resolved(printer)).read(lines), None]:
        list(own.timed(item))
    path = tmp_path / "sliced.gcode"
    path.write_bytes(b"".join(lines))
    played = play(path, workdir=tmp_path / "host")
    near(own.seconds, played.duration, 0.004 * played.duration, "print time, s")


def test_a_print_takes_as_long_as_told_where_a_command_swings_in_a_wipe(tmp_path: Path) -> None:
    """Klipper limits the filament's acceleration in moves that retract, by segments."""
    printer = load(str(OWNERS / "hbot-3000.toml"))
    lines = [b"G28\n", b"G92 X0 Y0 Z0\n", b"M83\n", b"M204 S5000\n", b"G1 X140 Y140 Z0.3 F6000\n"]
    for k in range(20):
        y = 140 + k % 2
        lines += [b"G1 X%d Y%d E0.5 F7200\n" % (x, y) for x in (150, 140)]
        lines += [b"G1 X142 Y%d E-0.228 F10000\n" % y, b"G1 E0.228 F1800\n"]
    text, report = converted(lines, printer)
    path = tmp_path / "converted.gcode"
    path.write_bytes(text)
    table = printer.firmware.own(KlipperTable)
    limits = {"max_velocity": table.velocity, "max_accel": table.acceleration}
    extruder = (
        f"\n[extruder]\nmax_extrude_only_velocity: {printer.limits.extruder_velocity}\n"
        f"max_extrude_only_accel: {printer.limits.extruder_acceleration}\n"
    )
    played = play(path, limits=limits, workdir=tmp_path / "host", sections=extruder)
    near(report.duration, played.duration, 0.005 * played.duration, "print time, s")
