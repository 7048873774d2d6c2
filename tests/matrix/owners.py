"""Two owners, of Klipper and of Marlin: their configurations, and the printers they record on.

Each makes a profile in the way that docs/start.md describes: `setup`, then `identify` on what the
sensor recorded of the printer. The folder of an owner is made once a session.
"""

import os
import shutil
from contextlib import chdir
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np

from hframe_post.arrays import Array
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.identification.recordings.accelerometer import GRAVITY
from hframe_post.identification.recordings.resonance_test import ResonanceTest
from hframe_post.printer.profile import load
from tests.command_line import run
from tests.printers import with_plant
from tests.recordings import write_klipper
from tests.resonance_recordings import SENSORS, X, Y, recorded
from tests.simulator import Axis, Chip, Machine, Mode

FILES = Path(__file__).parent / "owners"
PROFILE = "printer.toml"


@dataclass(frozen=True)
class Owner:
    """An owner. configuration: words of ``setup``."""

    name: str
    configuration: tuple[str, ...]
    machine: Machine
    chip: Chip
    belt_acceleration: float | None = None  # mm/s², lowered by hand because layers shifted

    @property
    def has_klipper(self) -> bool:
        return self.configuration[0].endswith(".cfg")


def _machine(kinematics: str, x: Mode, y: Mode) -> Machine:
    return Machine(Axis((x,)), Axis((y,)), 0.0, kinematics=kinematics)


SENSOR = replace(SENSORS["adxl345"], turned=(90.0, 3.0, 0.0))  # Klipper gives its own times
OWNERS = {
    owner.name: owner
    for owner in (
        Owner("voron", ("printer.cfg",),
              _machine("corexy", Mode(52.0, 0.05), Mode(38.0, 0.06)), SENSOR,
              belt_acceleration=9000.0),
        Owner("marlin500", ("m503.txt",),
              _machine("cartesian", Mode(42.0, 0.06), Mode(27.0, 0.09)),
              replace(SENSOR, drift=0.004)),
    )
}  # fmt: skip


def settle(owner: Owner, home: Path, records: bool) -> None:
    """Make the owner's folder: configuration, profile with the printer's true plant, recordings."""
    shutil.copytree(FILES / owner.name, home)
    with chdir(home):
        _done("setup", *owner.configuration)
        if owner.belt_acceleration is not None:
            lower_belts(owner.belt_acceleration)
        if records:
            Path("recordings").mkdir()
            (record_tests if owner.has_klipper else record_sweeps)(owner)
        windows, exact = load(PROFILE).compensation.windows, owner.machine.exact()
        text = with_plant(PROFILE, exact, windows, [], 0.05, None, date(2026, 6, 1))
        Path(PROFILE).write_bytes(text.encode())


def lower_belts(limit: float) -> None:
    """Edit the profile as docs/start.md advises where layers shift."""
    text = Path(PROFILE).read_text()
    Path(PROFILE).write_text(f"{text}\n[motors]\nbelt_acceleration = {limit:g}\n")


def _done(*words: str | Path) -> None:
    finished = run(*words, XDG_CONFIG_HOME=os.path.abspath("config"), HFRAME_PRINTER="")
    assert finished.returncode == 0, finished.stderr.decode()


def record_tests(owner: Owner) -> None:
    """Write what Klipper's sensors record of TEST_RESONANCES."""
    config = KlipperConfig(Path("printer.cfg"))
    for seed, (name, axis) in enumerate(((("y"), Y), (("x"), X))):
        test = ResonanceTest.from_config(config, axis, None)
        taken = recorded(owner.machine, test, owner.chip, 1, seed).recording
        write_klipper(Path(f"recordings/raw_data_{name}_20260601_1015{seed:02}.csv"), taken)


def record_sweeps(owner: Owner) -> None:
    """Write what a sensor next to a Marlin board records of `sweep`, started by hand."""
    _done("measure", "-p", PROFILE, "-q", "-o", "sweep.gcode")
    for seed, command in enumerate(sorted(Path().glob("sweep.*.csv"))):
        name = command.stem.removeprefix("sweep.")
        record(owner, command, Path(f"recordings/{name}.csv"), seed, in_g=True, lead=3.0)
        shutil.copy(command, "recordings")


def record(
    owner: Owner, command: Path, target: Path, seed: int, in_g: bool = False, lead: float = 0.0
) -> None:
    """Write what the sensor records while the printer plays a command's file."""
    motion: Array = np.loadtxt(command, delimiter=",", skiprows=1)[:, 1:]
    taken = replace(owner.chip, lead=lead).record(owner.machine, motion, seed)
    if not in_g:
        write_klipper(target, taken)
        return
    rows = np.column_stack([taken.t - taken.t[0], taken.a / GRAVITY])
    np.savetxt(target, rows, "%.6f", ",", header="time,x,y,z", comments="")
