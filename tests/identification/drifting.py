"""``python -m tests.identification.drifting``: printers that drift after `identify`, and `check`.

Each drawn printer is measured and identified. Then its modes drift, each by itself: frequencies and
contributions by up to a share, damping ratios by up to three times as much. Rows are RMS contour
errors of the rectangle on the drifted printer, relative to that of the exact model of all that is
linear: with no compensation, with the old profile, and after `check`.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from datetime import date
from functools import cache

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import HframeError
from hframe_post.identification.check import CheckReport, Drift, drifts, runs
from hframe_post.model.plant import Plant
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.random_printers import drawn, identified, judged, printer, recorded, struck
from tests.simulator import Axis, Chip, Machine, Mode

STEP = 0.0206  # mm of belt
SHARES = (0.01, 0.03, 0.05)


def drifted(machine: Machine, share: float, seed: int) -> Machine:
    """Return the machine with each mode's frequency, damping and contribution changed at random."""
    rng = np.random.default_rng((seed, 31))

    def mode(one: Mode) -> Mode:
        hz, damping, part = 1.0 + share * rng.uniform(-1.0, 1.0, 3) * (1.0, 3.0, 1.0)
        return Mode(hz * one.hz, damping * one.damping, part * one.share)

    def axis(one: Axis) -> Axis:
        modes = [mode(each) for each in one.modes]
        whole = sum(each.share for each in modes)
        return replace(one, modes=tuple(replace(m, share=m.share / whole) for m in modes))

    racking = replace(mode(machine.racking_mode), share=1.0)
    return replace(machine, x=axis(machine.x), y=axis(machine.y), racking_mode=racking)


def checked(machine: Machine, chip: Chip, profile: Printer, seed: int) -> dict[str, Drift]:
    """Return what `check` finds on the machine."""
    return drifts(profile.plant, recorded(machine, chip, runs(profile), seed, STEP))


def moved(plant: Plant, found: dict[str, Drift]) -> Plant:
    """Return the plant with what certainly drifted."""
    report = CheckReport(load("paper"), found, date(2026, 7, 1))
    return replace(plant, **report.moved)  # type: ignore[arg-type]


@cache
def measured_plant(seed: int) -> Plant | None:
    """Return the plant that `identify` finds of a drawn printer; None if it refuses."""
    machine, chip, _ = drawn(seed)
    try:
        found = identified(machine, struck(machine, chip, seed, step=STEP))
    except HframeError:
        return None
    return None if found.refusal else found.plant(machine.x_c)


def row(seed: int, share: float) -> Array | str | None:
    """Return µm: none, old, checked, exact; or the refusal of `check`; None if identify refused."""
    machine, chip, _ = drawn(seed)
    now, old = drifted(machine, share, seed), measured_plant(seed)
    if old is None:
        return None
    profile = replace(printer(machine), plant=old)
    try:
        plant = moved(old, checked(now, chip, profile, seed))
    except HframeError as error:
        return str(error)
    plants = old, plant, now.exact()
    before, after, exact = (judged(now, replace(profile, plant=one)) for one in plants)
    return np.array([before.none, before.compensated, after.compensated, exact.compensated])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=40, help="number of printers")
    count = parser.parse_args().count
    print("columns: not compensated, old profile, after check; relative to exact")
    for share in SHARES:
        for linear in (True, False):
            seeds = [seed for seed in range(count) if (drawn(seed)[2] == "linear") == linear]
            found = [row(seed, share) for seed in seeds]
            errors = np.array([one for one in found if isinstance(one, np.ndarray)])
            refused = sum(isinstance(one, str) for one in found)
            kind = "linear" if linear else "not linear"
            print(f"{share:.0%}, {kind}: {len(errors)} printers, {refused} refused")
            for name, of in (("median", np.median), ("worst", np.max)):
                print(f"  {name} {of(errors[:, :3] / errors[:, 3:], axis=0).round(2)}", flush=True)


if __name__ == "__main__":
    main()
