"""Seeded changes to other input files: binary G-code, recordings, step files, settings."""

from __future__ import annotations

import gzip
import io
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random

import numpy as np

from hframe_post.firmware.klipper.check import check
from hframe_post.firmware.klipper.macro_check import check_macros
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.firmware.marlin.m503 import MarlinSettings, from_marlin
from hframe_post.firmware.registry import FIRMWARES
from hframe_post.gcode.lines import as_binary, lines_of
from hframe_post.identification.recordings import accelerometer
from hframe_post.printer.profile import load
from hframe_post.printer.setup import Known, profile_text
from hframe_post.studies.comparison.compare import compare
from tests.conftest import ROOT, SAMPLES
from tests.fuzz import mutations
from tests.printers import M503, profile_of
from tests.slices import SLICES

RECTANGLE = (SAMPLES / "rectangle.gcode").read_bytes()
Reader = Callable[[Path], object]


def mutated(rng: Random, data: bytes) -> bytes:
    """Return data with a few bytes changed, a piece lost, doubled or overwritten, or a lost end."""
    for _ in range(1 + min(int(rng.expovariate(0.7)), 10)):
        at = rng.choice((rng.randrange(min(len(data), 200) + 1), rng.randrange(len(data) + 1)))
        size, kind = rng.choice((1, 2, 4, 8, 100, 5000)), rng.randrange(6)
        if kind <= 2:
            new = bytes(rng.choice((0, 1, 127, 255, rng.randrange(256))) for _ in range(size % 101))
            data = data[:at] + new + data[at + len(new) :]
        elif kind == 3:
            data = data[:at] + data[at + size :]
        elif kind == 4:
            data = data[:at] + data[at : at + size] + data[at:]
        else:
            data = data[:at] if rng.random() < 0.3 else data
    return data


def case(rng: Random, folder: Path) -> tuple[Path, Reader]:
    """Return a file and the function that reads it."""
    name = rng.choice(list(READERS))
    original = originals()[name]
    if name in ("cfg", "m503", "compare") and rng.random() < 0.7:
        lines = original.splitlines()
        for _ in range(1 + min(int(rng.expovariate(0.5)), 8)):
            if lines:
                change = rng.choices(mutations.MUTATIONS, mutations.WEIGHTS)[0]
                change(rng, lines, rng.randrange(len(lines)))
        data = b"\n".join(lines)
    else:
        data = mutated(rng, original)
    path = folder / f"a.{SUFFIXES.get(name, name)}"
    path.write_bytes(data)
    return path, READERS[name]


def _compared(path: Path) -> object:
    a, b = RECTANGLE.splitlines(keepends=True), path.read_bytes().splitlines(keepends=True)
    return [compare(a, b, each.dialect) for each in FIRMWARES.values()]


def _configured(path: Path) -> object:
    config = KlipperConfig(path)
    own = profile_of(config)
    return [
        *check(config, own, "change it"),
        *check(config, load("paper"), "change it"),
        *check_macros(config, own, "write it"),
    ]


def _answered(path: Path) -> object:
    settings = MarlinSettings([path])
    travel = settings.travel() or {axis: Known((0.0, 220.0), "test") for axis in "xy"}
    tables = from_marlin(settings, "cartesian", travel)
    return settings.warnings(), settings.kinematics(), profile_text(tables, "own")


def _recorded(path: Path) -> object:
    return accelerometer.oriented(accelerometer.read(path))


def _binary(path: Path) -> object:
    with path.open("rb") as file:
        return sum(map(len, lines_of(file)))


READERS: dict[str, Reader] = {
    "bgcode": _binary, "recording": _recorded, "cfg": _configured,
    "m503": _answered,
    "compare": _compared,
}  # fmt: skip
SUFFIXES = {"compare": "gcode", "recording": "csv.gz"}


@cache
def originals() -> dict[str, bytes]:
    """Return files as the tool and other programs write them."""
    rng = np.random.default_rng(0)
    samples = np.column_stack([np.arange(0.0, 3.0, 1e-3), rng.normal(size=(3000, 3))])
    recording, binary = io.BytesIO(), io.BytesIO()
    np.savetxt(recording, samples, "%.6f", ",", header="time,accel_x,accel_y,accel_z")
    with as_binary(binary) as file:
        file.writelines(SLICES["prusaslicer"].lines)
    config = ROOT / "tests" / "klipper" / "printer.cfg"
    return {
        "bgcode": binary.getvalue(), "recording": gzip.compress(recording.getvalue(), mtime=0),
        "cfg": config.read_bytes(), "m503": M503.read_bytes(),
        "compare": RECTANGLE,
    }  # fmt: skip
