"""Simulated printers with random parameters and faults: measured, identified and judged."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Z
from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.identification.identify import Identified, MeasurementSettings, Run, identify
from hframe_post.identification.recordings.clock import Clock
from hframe_post.identification.recordings.runs import PlannedRun
from hframe_post.identification.recordings.strokes import runs
from hframe_post.model.kinematics import Kinematics
from hframe_post.prediction.predict import contour_error
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from hframe_post.studies.tuning import rectangle
from tests.gcode_tools import layers
from tests.paths import in_motion
from tests.simulator import Axis, Chip, Machine, Mode

BAND = (3.0, 100.0)


def printer(machine: Machine) -> Printer:
    """Return the paper's bed and limits with the machine's kinematics."""
    paper = load("paper")
    racks = machine.kinematics == "hbot"
    plant = paper.plant if racks else replace(paper.plant, Gxtheta=None)
    return replace(paper, plant=plant, kinematics=Kinematics(machine.kinematics))


BEGUN = 1234.5  # s of print time at which the simulator's motions begin


def recorded(
    machine: Machine, chip: Chip, planned: Sequence[PlannedRun], seed: int, step: float = 0.0
) -> list[Run]:
    """Return runs of known start. step: mm of belt that a motor step moves."""
    clock = Clock(BEGUN, is_exact=True)
    return [
        Run(run.name, run.command, chip.record(machine, run.command, 100 * seed + k, step), clock)
        for k, run in enumerate(planned)
    ]


def struck(
    machine: Machine, chip: Chip, seed: int, seconds: float = 60.0, step: float = 0.0
) -> list[Run]:
    """Return recordings of the strokes of `measure` at the default places."""
    return recorded(machine, chip, runs(printer(machine), seconds=seconds), seed, step)


def identified(machine: Machine, runs: list[Run]) -> Identified:
    """Return what the tool identifies from the runs."""
    return identify(runs, MeasurementSettings(BAND, racks=printer(machine).kinematics.racks))


@dataclass(frozen=True)
class Errors:
    """RMS contour errors, µm, of the true machine."""

    none: float
    compensated: float


def judged(machine: Machine, profile: Printer, path: str = "rectangle") -> Errors:
    """Return the contour errors of the machine, without and with compensation by the profile."""
    lines = rectangle(profile) if path == "rectangle" else layers("cube.gcode", 2)
    options = Options("racking", clamp=True)
    computed = WholeFile(lines, profile, options).samples(("racking", "none"))
    chunks = [chunk for chunk in computed if len(chunk)]
    wanted = np.concatenate([chunk.xyze[:, :Z] for chunk in chunks])
    moving = np.concatenate([in_motion(chunk.xyze)[1] for chunk in chunks])
    errors = {}
    for name in ("none", "racking"):
        command = np.concatenate([chunk.commands[name] for chunk in chunks])
        nozzle = np.vstack([command[:1], machine.played(command)[:, :2]])
        errors[name] = float(np.sqrt((contour_error(wanted, nozzle)[moving] ** 2).mean()))
    return Errors(1e3 * errors["none"], 1e3 * errors["racking"])


FAULTS = ("friction", "play", "second", "third", "along")


def drawn(seed: int) -> tuple[Machine, Chip, str]:
    """Return a random printer, its sensor, and its fault; every second printer is linear."""
    rng = np.random.default_rng(seed)
    fault = "linear" if seed % 2 == 0 else FAULTS[(seed // 2) % len(FAULTS)]
    kinematics = ("hbot", "hbot", "corexy", "cartesian")[int(rng.integers(4))]
    delay = float(rng.uniform(0.0, 3e-3))
    most = {"friction": 900.0, "play": 0.02, "second": 0.05, "third": 0.05}
    size = float(rng.uniform(0.2, 1.0))
    flaw = {fault: size * most[fault]} if fault in most else {}

    def axis() -> Axis:
        main = Mode(float(rng.uniform(18.0, 55.0)), float(rng.uniform(0.03, 0.15)))
        if rng.random() < 0.5:
            return Axis((main,), delay, **flaw)
        share = float(rng.uniform(0.05, 0.25))
        other = Mode(float(rng.uniform(60.0, 90.0)), float(rng.uniform(0.03, 0.1)), share)
        return Axis((replace(main, share=1.0 - share), other), delay, **flaw)

    x, y = axis(), axis()
    racks = float(rng.uniform(0.5e-8, 3e-8)) if kinematics == "hbot" else 0.0
    mode = Mode(float(rng.uniform(40.0, 80.0)), float(rng.uniform(0.05, 0.15)))
    along = float(rng.uniform(-0.1, 0.1)) / 120.0 if fault == "along" else 0.0
    machine = Machine(
        x, y, racks, mode, float(rng.uniform(130.0, 150.0)), along, kinematics=kinematics
    )
    tilt = rng.uniform(-5.0, 5.0, 3)
    gains = rng.uniform(0.95, 1.05, 3)
    chip = Chip(
        (float(gains[0]), float(gains[1]), float(gains[2])),
        float(rng.uniform(-0.02, 0.02)),
        (float(tilt[0]), float(tilt[1]), float(tilt[2])),
        noise=float(np.exp(rng.uniform(0.0, np.log(20.0)))),
        jitter=1e-5,
        rate_error=float(rng.uniform(-0.02, 0.02)),
    )
    return machine, chip, fault
