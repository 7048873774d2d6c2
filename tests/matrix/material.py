"""What a row of the matrix needs besides the printer: recordings, filled forms, and foreign files.

Each comes in three kinds: good; hard, of which nothing can be made; and foreign, of another format.
"""

import tomllib
from pathlib import Path

from hframe_post.printer.profile import load
from tests.command_line import run
from tests.matrix.files import SMALL, STL, sliced, too_fast
from tests.matrix.owners import OWNERS, PROFILE, record

PART = "my part.gcode"


def put_print(kind: str, printer: str) -> list[str]:
    """Put the print of a kind, and a good one to compare it with, into this folder."""
    own = OWNERS.get(printer)
    # motors whose limits were lowered stop earlier than at the edge of the bed
    lowered = own is not None and own.belt_acceleration is not None
    edge = None if lowered else load(PROFILE if own else printer).travel.x[1]
    content = {"good": sliced(SMALL), "hard": too_fast(SMALL, edge), "foreign": STL}[kind]
    Path(PART).write_bytes(content)
    Path("good.gcode").write_bytes(sliced(SMALL))
    return [PART]


def put_recordings(kind: str, made: Path) -> list[str]:
    """Put recordings of Klipper's or of our own tests into a folder ``held``.

    made: the owner's recordings. A hard recording was cut off after a few seconds.
    """
    held = Path("held")
    held.mkdir()
    if kind == "foreign":
        (held / "raw_data_x_20260601_101500.csv").write_bytes(STL)
        return [held.name]
    for path in sorted(made.iterdir()):
        content = path.read_bytes()
        if kind == "hard" and not path.name.startswith("sweep."):
            lines = content.splitlines(keepends=True)
            content = b"".join(lines[: min(9000, len(lines) // 3)])
        (held / path.name).write_bytes(content)
    return [held.name]


def put_run(kind: str, printer: str) -> list[str]:
    """Let ``check`` write its run, and put what the sensor records of it here."""
    Path("held").mkdir()
    if printer not in OWNERS:  # whose plant is not measured, so that there is no run
        (Path("held") / "adxl345-check-x.csv").write_bytes(STL)
        return ["held"]
    done = run("measure", "--for", "check", "-p", PROFILE, "-o", "held/check.gcode")
    if not OWNERS[printer].has_klipper:  # Marlin has no such run
        assert done.returncode == 1
        (Path("held") / "adxl345-check-x.csv").write_bytes(STL)
        return ["held"]
    assert done.returncode == 0, done.stderr.decode()
    for seed, motion in enumerate(sorted(Path("held").glob("*.csv"))):
        name = motion.stem.partition(".")[2]
        target = Path("held") / f"adxl345-{name}.csv"
        if kind == "foreign":
            target.write_bytes(STL)
            continue
        record(OWNERS[printer], motion, target, seed)
        if kind == "hard":
            lines = target.read_bytes().splitlines(keepends=True)
            target.write_bytes(b"".join(lines[: len(lines) // 4]))
    return ["held"]


def put_form(kind: str, printer: str) -> list[str]:
    """Print a tower and fill in its form ``t.form.toml``: waves of 40 Hz, or impossible ones."""
    named = PROFILE if printer in OWNERS else printer
    done = run("calibrate-print", "-p", named, "--heat", "210,60", "-o", "t.gcode")
    assert done.returncode == 0, done.stderr.decode()
    Path("t.gcode").unlink()
    form = Path("t.form.toml")
    text = form.read_text()
    hz = {"good": 40.0, "hard": 400.0, "foreign": 0.0}[kind]
    for k, speed in enumerate(tomllib.loads(text)["print"]["speeds"], start=1):
        for axis in "xy":
            waves = f"{axis}{k} = [{3.0 * speed / max(hz, 1.0):.1f}, 3, 4]"
            text = text.replace(f"{axis}{k} = [0, 0, 0]", waves)
    form.write_bytes(STL if kind == "foreign" else text.encode())
    return [form.name]


def put_config(kind: str, printer: str, with_options: bool) -> list[str]:
    """Put the owner's configuration here: as it is, with an impossible number, or none."""
    name, *options = OWNERS[printer].configuration
    source = Path(name)
    text = source.read_bytes()
    if kind == "hard":
        text = text.replace(b"max_accel: ", b"max_accel: -").replace(b"M203 X", b"M203 X-")
    source.write_bytes(STL if kind == "foreign" else text)
    return [name, *options] if with_options else [name]
