"""Printers that drift after `identify`: each mode by itself, and what `check` finds."""

from dataclasses import replace
from datetime import date

import numpy as np

from hframe_post.identification.check import CheckReport, Drift, drifts, runs
from hframe_post.model.plant import Plant
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.random_printers import recorded
from tests.simulator import Axis, Chip, Machine, Mode

STEP = 0.0206  # mm of belt


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
