"""Predict the errors and times of prints on owners' printers, and play both files.

The profiles are as `identify` wrote them: two of published recordings, two of simulated printers.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import hframe_post as hp
from hframe_post.printer.firmware_tables import KlipperTable, MarlinTable
from hframe_post.studies import simulation
from tests.klipper.host import play
from tests.marlin.planner import Build, Machine

OWNERS = Path(__file__).parent / "owners"
PROFILES = tuple(
    str(OWNERS / f"{name}.toml")
    for name in ("corexy-3000", "corexy-10000", "bedslinger-500", "hbot-3000")
)
HEAD = (
    "print", "printer", "none", "best shaper", "converted", "5 % off", "10 % off", "time", "played",
)  # fmt: skip
ROOM = (-50.0, 450.0)  # mm: slices of other owners fit on the bed
OFF, DRAWS = (0.05, 0.1), 8
LONG_FILE = 500_000  # bytes of a print that the simulated board does not play: it keeps each step


def rows(prints: Iterable[Path], profiles: Sequence[str] = PROFILES) -> Iterator[list[str]]:
    """Yield a row for each print and profile, as HEAD names its cells."""
    for sliced in prints:
        for profile in profiles:
            yield [sliced.stem, Path(profile).stem, *row(sliced, wide(hp.load_printer(profile)))]


def row(sliced: Path, printer: hp.Printer) -> Iterator[str]:
    """Yield errors in µm RMS while extruding, and by how much the conversion changes the time."""
    with TemporaryDirectory() as folder:
        made = Path(folder) / "out.gcode"
        report = hp.convert(sliced, made, printer)
        for name in ("none", "shaper", "racking"):
            yield f"{report.contour[name].micrometres()['rms']:.1f}"
        yield from inexact(sliced, printer)
        yield f"{100.0 * report.time.change:+.1f} %"
        if printer.firmware.table(MarlinTable) is not None and sliced.stat().st_size > LONG_FILE:
            yield "–"
        else:
            yield f"{100.0 * (played(made, printer) / played(sliced, printer) - 1.0):+.1f} %"


def inexact(sliced: Path, printer: hp.Printer) -> Iterator[str]:
    """Yield the median of printers that differ from the model by up to a share, for each share."""
    options = hp.Options("racking", ("racking",)).resolved(printer)
    similar = {share: printer.plant.drawn(share, DRAWS, 0) for share in OFF}
    study = simulation.Study(printer.plant, similar, name=printer.name)
    lines = sliced.read_bytes().splitlines(keepends=True)
    for found in simulation.simulate(lambda: iter(lines), printer, options, study).model_error:
        yield f"{1e3 * median(found.rms('racking')):.1f}"


def wide(printer: hp.Printer) -> hp.Printer:
    return replace(printer, travel=replace(printer.travel, x=ROOM, y=ROOM))


def played(gcode: Path, printer: hp.Printer) -> float:
    """Return the seconds of motion on Klipper's own host, or on a simulated board with Marlin."""
    if printer.firmware.dialect == "marlin":
        return on_a_board(gcode, printer)
    with TemporaryDirectory() as folder:
        homed = Path(folder) / "homed.gcode"  # a macro does it in many files
        homed.write_bytes(b"G28\n" + gcode.read_bytes())
        return play(homed, workdir=Path(folder), sections=sections(printer)).duration


def sections(printer: hp.Printer) -> str:
    """Return what was in the printer.cfg that the profile was made from, on a wide bed."""
    own, limits, (least, most) = printer.firmware.table(KlipperTable), printer.limits, ROOM
    assert own is not None
    return f"""
[gcode_arcs]
[firmware_retraction]
[stepper_x]
position_min: {least}
position_max: {most}
[stepper_y]
position_min: {least}
position_max: {most}
[printer]
max_velocity: {own.velocity}
max_accel: {own.acceleration}
square_corner_velocity: {own.square_corner_velocity}
minimum_cruise_ratio: {own.minimum_cruise_ratio}
max_z_velocity: {limits.z_velocity}
max_z_accel: {limits.z_acceleration}
[extruder]
max_extrude_only_velocity: {limits.extruder_velocity}
max_extrude_only_accel: {limits.extruder_acceleration}
instantaneous_corner_velocity: {limits.extruder_corner_velocity}
"""


def on_a_board(gcode: Path, printer: hp.Printer) -> float:
    own, limits, steps = printer.firmware.table(MarlinTable), printer.limits, printer.steps
    assert own is not None
    assert steps is not None
    build = Build(
        steps.belt, steps.z, steps.e, cartesian=printer.kinematics.type == "cartesian",
        planner=own.planner,
        max_velocity=[*own.max_velocity, limits.z_velocity, limits.extruder_velocity],
        max_acceleration=[*own.max_acceleration, limits.z_acceleration, own.max_acceleration_e],
        acceleration=own.acceleration, travel_acceleration=own.travel_acceleration,
        retract_acceleration=own.retract_acceleration, junction_deviation=own.junction_deviation,
    )  # fmt: skip
    return sum(run.duration for run in Machine(build).read(gcode.read_bytes()))
