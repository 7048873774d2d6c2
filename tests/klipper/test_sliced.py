"""What a print has and takes as sliced, against the trapezoids of Klipper's own host."""

from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import TS, Array
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Beginning, Chain, Stages
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.firmware.registry import firmware
from hframe_post.planner import sampling
from hframe_post.planner.lookahead import plan
from hframe_post.planner.sliced import AsSliced
from hframe_post.prediction.best_shaper import error
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.gcode_tools import converted, hops, layers, quirk
from tests.klipper.host import Playback, play
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


LATE = 12  # ms

SLOW = quirk("slow_motion")


def motion(run: Playback, seconds: float) -> Array:
    """Return x, y, z, e (n, 4) every millisecond from the end of the first lift on."""
    t = float(run.moves["print_time"][1]) + np.arange(0.0, seconds, 1e-3)
    return np.column_stack([run.position(t), run.extruded(t)])


def test_slow_motion_is_written_as_any(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Within 10 ms: at 20 mm/min the last digit of a place is 3 ms."""
    short, computed = (tmp_path / name for name in ("short.gcode", "computed.gcode"))
    made = converted(SLOW, load("paper"))[0]
    monkeypatch.setattr(sampling, "FEWEST", 1 << 60)  # samples of all motion
    texts = made, converted(SLOW, load("paper"))[0]
    assert texts[0] != texts[1]
    for file, text in zip((short, computed), texts, strict=True):
        file.write_bytes(text)
    runs = [play(file, workdir=tmp_path / file.stem) for file in (short, computed)]
    seconds = [float(run.moves["print_time"][-1] - run.moves["print_time"][1]) for run in runs]
    assert seconds[0] == pytest.approx(seconds[1], abs=0.01)
    here, there = (motion(run, min(seconds)) for run in runs)
    inner = here[LATE:-LATE]
    apart = np.full(len(inner), np.inf)
    for first in range(2 * LATE + 1):
        off = inner - there[first : first + len(inner)]
        apart = np.minimum(apart, np.sqrt(np.square(off).sum(axis=1)))
    assert apart.max() < 0.08, "mm; at 100 mm/s samples are 0.1 mm apart"


@pytest.mark.parametrize("feed", [1, 10, 100])
def test_samples_do_not_grow_with_the_time_that_slow_lines_take(feed: int) -> None:
    lines = [b"G28\n", b"G0 X50 Y50 Z0.3 F6000\n", b"M83\n", b"G1 X60 F6000\n"]
    lines += [b"G1 X%d E1 F%d\n" % (100 - 40 * (k % 2), feed) for k in range(10)]
    lines += [b"G4 P%d\n" % (1_000_000 / feed), b"G1 E-9 F%d\n" % feed, b"G1 Z9.3 F%d\n" % feed]
    printer, options = load("paper"), Options("racking")
    chain = Chain(printer, options)
    stages = Stages(chain, beginning=Beginning())
    planned = plan(chain.read(lines), printer.limits)
    chunks = list(stages.predicted(stages.commands(planned)))
    seconds = (10 * 40 + 9 + 9) * 60 / feed + 1000 / feed
    assert stages.ledger().duration == pytest.approx(seconds, abs=2.0), "s"
    assert sum(map(len, chunks)) < 60_000
