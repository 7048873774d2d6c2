"""Single fuzz cases, run by a pool of processes."""

from __future__ import annotations

import tempfile
import warnings
from functools import cache, partial
from pathlib import Path
from random import Random

from threadpoolctl import threadpool_limits

from hframe_post.identification.recordings import excitation
from hframe_post.identification.recordings.sweep import positions, runs
from hframe_post.printer.profile import load, shipped
from tests.fuzz import files, klipper, mutations, oracle
from tests.fuzz.arcs import arcs
from tests.fuzz.child import Outcome, run_in_child

KINDS = ("gcode", "arcs", "profile", "table", "file")


def begin(folders: tuple[Path, ...]) -> None:
    """Load what all cases of a process share."""
    warnings.simplefilter("error")  # a numerical fault in numpy
    threadpool_limits(1)  # a fork has no other threads
    mutations.seeds(folders)
    tables()
    files.originals()
    shipped()
    for firmware in oracle.FIRMWARES:
        oracle.printer(firmware)
    oracle.check_arcs(0)


def run(kind: str, folders: tuple[Path, ...], played: int, seed: int) -> tuple[int, Outcome]:
    """Run one case; return its seed and outcome. Klipper plays one of ``played`` (0: none)."""
    checks = {
        "gcode": partial(_gcode, seed, folders, played),
        "arcs": partial(_arcs, seed, played),
        "profile": partial(oracle.check_profile, seed),
        "table": partial(_table, seed),
        "file": partial(_file, seed),
    }
    return seed, run_in_child(checks[kind])


def _gcode(seed: int, folders: tuple[Path, ...], played: int) -> str:
    word, text, output = oracle.check_gcode(seed, mutations.seeds(folders))
    if output and played and seed % played == 0:
        word = klipper.play_both(text, output)
    return word


def _arcs(seed: int, played: int) -> str:
    word, _, output = oracle.check_arcs(seed)
    if played and seed % played == 0:
        word = klipper.play_arcs(output, arcs(Random(seed))[1])
    return word


def _table(seed: int) -> str:
    with tempfile.TemporaryDirectory() as folder:
        return oracle.check_table(seed, tables(), Path(folder))


def _file(seed: int) -> str:
    with tempfile.TemporaryDirectory() as folder:
        return oracle.check_file(seed, Path(folder))


@cache
def tables() -> list[bytes]:
    """Return a command file and a recording, as the tool and Klipper write them."""
    rng = Random(0)
    rows = []
    for k in range(3000):
        x, y, z = rng.gauss(0, 50), rng.gauss(0, 50), rng.gauss(9810, 9)
        rows.append(f"{k * 3.1e-4:.6f},{x:.1f},{y:.1f},{z:.1f}")
    klipper = "#time,accel_x,accel_y,accel_z\n" + "\n".join(rows) + "\n"
    paper = load("paper")
    [planned] = runs(paper, 0, positions(paper, 0)[:1])
    return [klipper.encode(), b"".join(excitation.command_csv(planned.command))[:300_000]]
