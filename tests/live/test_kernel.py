"""Kernels: exact at rest and at constant speed, within the belts' limits, better than nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import TS, X, Y
from hframe_post.errors import ArgumentError
from hframe_post.firmware.klipper.live import _bounds, kernel_file, live_kernel
from hframe_post.hosts.klipper.kernel_file import read, signed
from hframe_post.model.kernel import kernel, played, strokes
from hframe_post.model.nozzle import nozzle
from hframe_post.printer.profile import load

PRINTERS = ("paper", "example-hbot", "example-corexy", "example-ender")


@pytest.mark.parametrize("name", PRINTERS)
def test_a_kernel_leaves_little_and_outruns_no_belt(name: str) -> None:
    printer = load(name)
    made, path = live_kernel(printer), strokes(_bounds(printer))
    command = made.command(path)
    belts = printer.kinematics.belts(*np.diff(command.T, n=2) / TS**2)
    assert np.abs(belts).max() <= printer.motors.belt_acceleration
    error = nozzle(printer.plant, path[0], played(command)) - path
    assert np.sqrt((error**2).sum(axis=1).mean()) == pytest.approx(made.figures.leaves, rel=1e-6)
    assert made.figures.leaves < 0.03 * made.figures.without
    assert np.abs(command - path).max() == pytest.approx(made.figures.deviation)


@pytest.mark.parametrize("name", PRINTERS)
def test_rest_is_exact_and_so_is_constant_speed(name: str) -> None:
    printer = load(name)
    made, plant = live_kernel(printer), printer.plant
    assert [taps.h.sum() for taps in made.axes] == pytest.approx([1.0, 1.0], abs=1e-14)
    assert all(abs(taps.h.sum()) < 1e-12 for _, taps in made.couplings)
    path = np.full((4000, 2), 50.0)
    path[1000:, Y] += 0.05 * np.arange(3000)  # 50 mm/s in y, which nothing couples to x
    error = nozzle(plant, path[0], played(made.command(path))) - path
    assert np.abs(error[2500:3200]).max() < 1e-6


def test_belts_that_cannot_follow_are_an_error_and_a_file_that_says_so() -> None:
    printer = load("example-corexy")
    bounds = replace(_bounds(printer), belt_acceleration=1000.0)
    with pytest.raises(ArgumentError, match="lower velocity or acceleration"):
        kernel(printer.plant, printer.kinematics, bounds)
    weak = replace(printer, invented=False, motors=replace(printer.motors, belt_acceleration=1e3))
    data = kernel_file(weak)
    assert data is not None
    with pytest.raises(ValueError, match="not a kernel"):
        read(data)


def test_a_file_gives_back_its_kernel() -> None:
    printer = replace(load("paper"), invented=False)
    made, data = live_kernel(printer), kernel_file(printer)
    assert data is not None
    found = read(data)
    assert found.x.weights == made.axes[X].h.tolist()
    assert found.y.ahead == made.axes[Y].ahead
    (coupling,), ((wanted, taps),) = found.couplings, made.couplings
    assert coupling[:4] == (Y, X, X, wanted.centre)
    assert coupling.taps.weights == taps.h.tolist()
    assert found.names["kinematics"] == "corexy"
    assert kernel_file(load("paper")) is None  # not measured
    assert kernel_file(replace(load("paper-marlin"), invented=False)) is None


def test_each_damaged_byte_is_refused() -> None:
    names = "".join(f"{name} = 1\n" for name in ("profile", "made_by", "measured", "kinematics"))
    numbers = ("velocity", "acceleration", "leaves", "without", "deviation", "belt_velocity",
               "belt_acceleration")  # fmt: skip
    text = names + "".join(f"{name} = 1\n" for name in numbers)
    data = signed(f"{text}x = 1 0.5 0.5\ny = 0 1\ncoupling = y x - 0 0 0.1\n")
    assert read(data).x.weights == [0.5, 0.5]
    for place in range(len(data)):
        for change in (1, 0x80):
            damaged = bytearray(data)
            damaged[place] ^= change
            with pytest.raises(ValueError, match="hframe-post identify"):
                read(bytes(damaged))
    for cut in range(len(data)):
        with pytest.raises(ValueError, match="hframe-post identify"):
            read(data[:cut])
    for wrong in ("x = 1 0.5 nan\n", "x = 2 0.5 0.5\n", "w = 1\n", "x = -1 1\n", "coupling = q\n"):
        with pytest.raises(ValueError):  # noqa: PT011  any: Klipper shows it
            read(signed(f"{text}y = 0 1\n{wrong}"))
