"""What a row of the matrix needs besides the printer: a print, recordings, a filled form.

The print is the sample cube as CuraEngine sliced it, cut to its first layers.
"""

import shutil
import tomllib
from pathlib import Path

from tests.command_line import run
from tests.gcode_tools import sliced
from tests.matrix.owners import OWNERS, PROFILE, record

PART = "my part.gcode"
HZ = 40.0  # of the waves on a tower


def put_print() -> list[str]:
    """Put the print here."""
    Path(PART).write_bytes(b"".join(sliced(2)))
    return [PART]


def put_recordings(made: Path) -> list[str]:
    """Copy the owner's recordings into a folder ``held``."""
    shutil.copytree(made, "held")
    return ["held"]


def put_run(printer: str) -> list[str]:
    """Let ``check`` write its run, and put what the sensor records of it here."""
    Path("held").mkdir()
    done = run("measure", "--for", "check", "-p", PROFILE, "-o", "held/check.gcode")
    if not OWNERS[printer].has_klipper:  # Marlin has no such run
        assert done.returncode == 1
        (Path("held") / "adxl345-check-x.csv").write_text("solid cube\n")
        return ["held"]
    assert done.returncode == 0, done.stderr.decode()
    for seed, motion in enumerate(sorted(Path("held").glob("*.csv"))):
        name = motion.stem.partition(".")[2]
        record(OWNERS[printer], motion, Path("held") / f"adxl345-{name}.csv", seed)
    return ["held"]


def put_form() -> list[str]:
    """Print a tower and fill in its form ``t.form.toml``."""
    done = run("calibrate-print", "-p", PROFILE, "--heat", "210,60", "-o", "t.gcode")
    assert done.returncode == 0, done.stderr.decode()
    Path("t.gcode").unlink()
    form = Path("t.form.toml")
    text = form.read_text()
    for k, speed in enumerate(tomllib.loads(text)["print"]["speeds"], start=1):
        for axis in "xy":
            waves = f"{axis}{k} = [{3.0 * speed / HZ:.1f}, 3, 4]"
            text = text.replace(f"{axis}{k} = [0, 0, 0]", waves)
    form.write_text(text)
    return [form.name]
