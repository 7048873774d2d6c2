"""Make the profiles of two simulated owners, as `setup` and `identify` write them for real ones.

python -m tests.benchmarks.simulated: an H-bot that racks as the paper's does, and a slow
bed-slinger with Marlin. The other owners' profiles are of published recordings.
"""

import shutil
from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hframe_post.arrays import X, Y
from hframe_post.cli.main import main
from hframe_post.model.nozzle import nozzle
from hframe_post.printer.profile import load
from tests.owners.owners import FILES, OWNERS
from tests.recordings import write_klipper
from tests.simulator import Chip

OWN, PROFILE = Path(__file__).parent / "owners", "printer.toml"
HBOT_CFG = """\
[printer]
kinematics: corexy
max_velocity: 300
max_accel: 3000
square_corner_velocity: 5
max_z_velocity: 20
max_z_accel: 500
[stepper_x]
microsteps: 16
rotation_distance: 40
position_max: 280
[stepper_y]
microsteps: 16
rotation_distance: 40
position_max: 295
[stepper_z]
microsteps: 16
rotation_distance: 8
[extruder]
microsteps: 16
rotation_distance: 22.68
nozzle_diameter: 0.4
filament_diameter: 1.75
[resonance_tester]
accel_chip: adxl345
probe_points: 140, 147, 20
"""


def hbot(home: Path) -> None:
    """Make the profile of an owner of the paper's printer in a folder."""
    with chdir(home):
        Path("printer.cfg").write_text(HBOT_CFG)
        _run("setup", "printer.cfg", "--kinematics", "hbot")
        _run("measure", "-p", PROFILE, "-o", "measure.gcode", "-q")
        plant = load("paper").plant
        Path("recordings").mkdir()
        for seed, file in enumerate(sorted(Path().glob("measure.*.csv"))):
            command = np.loadtxt(file, delimiter=",", skiprows=1)[:, 1:]
            moved = nozzle(plant, command[0], command)
            recording = Chip().on_nozzle(moved[:, X], moved[:, Y], seed)
            name = file.stem.removeprefix("measure.")
            write_klipper(Path(f"recordings/adxl345-{name}.csv"), recording)
            shutil.copy(file, "recordings")
        _run("identify", "recordings", "-p", PROFILE, "-o", PROFILE)


def keep(home: Path, name: str) -> None:
    """Copy a folder's profile and model to the benchmarks under a name."""
    text = (home / PROFILE).read_text().replace("printer.model.toml", f"{name}.model.toml")
    (OWN / f"{name}.toml").write_text(text)
    shutil.copy(home / "printer.model.toml", OWN / f"{name}.model.toml")


def _run(*words: str) -> None:
    main(words, standalone_mode=False)


if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        owner = OWNERS["marlin500"]
        shutil.copytree(FILES / "marlin500", bed := Path(folder) / "bed")
        with chdir(bed):
            _run("setup", owner.configuration)
            _run("measure", "-p", PROFILE, "-q", "-o", "m.gcode")
            owner.record("m.*.csv", "recordings")
            _run("identify", "recordings", "-p", PROFILE, "-o", PROFILE)
        keep(bed, "bedslinger-500")
        (home := Path(folder) / "hbot").mkdir()
        hbot(home)
        keep(home, "hbot-3000")
