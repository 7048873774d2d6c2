"""Single cases, as a pool of processes runs them."""

from __future__ import annotations

import tempfile
import traceback
import warnings
from functools import cache
from pathlib import Path
from random import Random

from hframe_post.identification import command_file
from hframe_post.identification.sweep import positions, runs
from hframe_post.printer.profile import load
from tests.fuzz import mutations, oracle

KINDS = ("gcode", "arcs", "profile", "table")


def run(kind: str, folders: tuple[Path, ...], seed: int) -> tuple[int, str, str]:
    """One case: its seed, what came of it, and the defect, if any."""
    warnings.simplefilter("error")  # a number went wrong somewhere
    try:
        if kind == "gcode":
            return seed, oracle.check_gcode(seed, mutations.seeds(folders)), ""
        if kind == "arcs":
            return seed, oracle.check_arcs(seed), ""
        if kind == "profile":
            return seed, oracle.check_profile(seed), ""
        with tempfile.TemporaryDirectory() as folder:
            return seed, oracle.check_table(seed, tables(), Path(folder)), ""
    except Exception:
        return seed, "DEFECT", traceback.format_exc(limit=-4)


@cache
def tables() -> list[bytes]:
    """A command and a recording, as the tool and Klipper write them."""
    rng = Random(0)
    rows = []
    for k in range(3000):
        x, y, z = rng.gauss(0, 50), rng.gauss(0, 50), rng.gauss(9810, 9)
        rows.append(f"{k * 3.1e-4:.6f},{x:.1f},{y:.1f},{z:.1f}")
    klipper = "#time,accel_x,accel_y,accel_z\n" + "\n".join(rows) + "\n"
    paper = load("paper")
    [planned] = runs(paper, 0, positions(paper)[:1])
    return [klipper.encode(), b"".join(command_file.written(planned.command))[:300_000]]
