"""Two owners, of Klipper and of Marlin: their configurations, and the printers they record on."""

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hframe_post.arrays import Array
from hframe_post.identification.recordings.accelerometer import GRAVITY
from tests.recordings import write_klipper
from tests.resonance_recordings import SENSORS
from tests.simulator import Axis, Chip, Machine, Mode


@dataclass(frozen=True)
class Owner:
    """An owner. configuration: what ``setup`` reads. by_hand: whether they start the sensor."""

    configuration: str
    machine: Machine
    chip: Chip
    by_hand: bool

    def record(self, motions: str, folder: str) -> None:
        """Copy the motions that ``measure`` wrote, and write what the sensor records of each."""
        Path(folder).mkdir()
        for seed, path in enumerate(sorted(Path().glob(motions))):
            shutil.copy(path, folder)
            motion: Array = np.loadtxt(path, delimiter=",", skiprows=1)[:, 1:]
            name = path.stem.partition(".")[2]
            if not self.by_hand:
                taken = self.chip.record(self.machine, motion, seed)
                write_klipper(Path(folder) / f"adxl345-{name}.csv", taken)
                continue
            taken = replace(self.chip, lead=3.0).record(self.machine, motion, seed)
            rows = np.column_stack([taken.t - taken.t[0], taken.a / GRAVITY])
            header = "time,x,y,z"
            np.savetxt(Path(folder) / f"{name}.csv", rows, "%.6f", ",", header=header, comments="")


def _machine(kinematics: str, x: Mode, y: Mode) -> Machine:
    return Machine(Axis((x,)), Axis((y,)), 0.0, kinematics=kinematics)


SENSOR = replace(SENSORS["adxl345"], turned=(90.0, 3.0, 0.0))  # Klipper gives its own times
OWNERS = {
    "voron": Owner(
        "printer.cfg", _machine("corexy", Mode(52.0, 0.05), Mode(38.0, 0.06)), SENSOR, False
    ),
    "marlin500": Owner(
        "m503.txt", _machine("cartesian", Mode(42.0, 0.06), Mode(27.0, 0.09)),
        replace(SENSOR, drift=0.004), True,
    ),
}  # fmt: skip
FILES = Path(__file__).parent
