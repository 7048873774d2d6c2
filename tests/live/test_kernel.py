"""Kernels: exact at rest and at constant speed, within the belts' limits, better than nothing."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hframe_post.arrays import TS, Y
from hframe_post.errors import ArgumentError
from hframe_post.firmware.klipper.live import bounds_of, kernel_file, live_kernel
from hframe_post.hosts.klipper.kernel_file import FIGURES, LIMITS, TAPS, read, signed
from hframe_post.model.kernel import kernel, played, strokes
from hframe_post.model.plant import nozzle
from hframe_post.printer.profile import load

PRINTERS = ("paper", "example-hbot", "example-corexy", "example-ender")


@pytest.mark.parametrize("name", PRINTERS)
def test_a_kernel_leaves_little_and_outruns_no_belt(name: str) -> None:
    printer = load(name)
    (made, figures), path = live_kernel(printer), strokes(bounds_of(printer))
    command = made.command(path)
    belts = printer.kinematics.belts(*np.diff(command.T, n=2) / TS**2)
    assert np.abs(belts).max() <= printer.motors.belt_acceleration
    bounds, most = bounds_of(printer), figures.reserve * bounds_of(printer).acceleration
    faster = replace(bounds, acceleration=most, corner=figures.reserve * bounds.corner)
    for k, limit in ((1, printer.motors.belt_velocity), (2, printer.motors.belt_acceleration)):
        rates = printer.kinematics.belts(*np.diff(made.command(strokes(faster)).T, n=k) / TS**k)
        assert np.abs(rates).max() <= 1.001 * limit
    error = nozzle(printer.plant, path[0], played(command)) - path
    assert np.sqrt((error**2).sum(axis=1).mean()) == pytest.approx(figures.leaves, rel=1e-6)
    assert figures.leaves < 0.03 * figures.without
    assert np.abs(command - path).max() == pytest.approx(figures.deviation)


@pytest.mark.parametrize("name", PRINTERS)
def test_rest_is_exact_and_so_is_constant_speed(name: str) -> None:
    printer = load(name)
    (made, _), plant = live_kernel(printer), printer.plant
    assert [h.sum() for h in made.axes] == pytest.approx([1.0, 1.0], abs=1e-14)
    assert made.racking is None or abs(made.racking[1].sum()) < 1e-12
    path = np.full((4000, 2), 50.0)
    path[1000:, Y] += 0.05 * np.arange(3000)  # 50 mm/s in y, which nothing couples to x
    error = nozzle(plant, path[0], played(made.command(path))) - path
    assert np.abs(error[2500:3200]).max() < 1e-6


def test_belts_that_cannot_follow_are_an_error_and_a_file_that_says_so() -> None:
    printer = load("example-corexy")
    bounds = replace(bounds_of(printer), belt_acceleration=1000.0)
    with pytest.raises(ArgumentError, match="lower velocity or acceleration"):
        kernel(printer.plant, printer.kinematics, bounds)
    weak = replace(printer, invented=False, motors=replace(printer.motors, belt_acceleration=1e3))
    data = kernel_file(weak)
    assert data is not None
    with pytest.raises(ValueError, match="not a kernel"):
        read(data)


def test_a_file_gives_back_its_kernel() -> None:
    printer = replace(load("paper"), invented=False)
    (made, figures), data = live_kernel(printer), kernel_file(printer)
    assert data is not None
    found = read(data)
    assert (found["x"], found["y"]) == tuple(h.tolist() for h in made.axes)
    assert made.racking is not None
    racking, h = made.racking
    assert (found["x_c"], found["racking"]) == (racking.x_c, h.tolist())
    assert found["kinematics"] == "corexy"
    assert found["leaves"] == pytest.approx(figures.leaves, rel=1e-5)
    assert kernel_file(load("paper")) is None  # not measured
    assert kernel_file(replace(load("paper-marlin"), invented=False)) is None


def a_kernel() -> dict[str, Any]:
    zeros = [0.0] * TAPS
    names = dict.fromkeys(("profile", "made_by", "measured", "kinematics"), "1")
    limits = dict.fromkeys(LIMITS, 1.0)
    return {
        **names, "limits": limits, **dict.fromkeys(FIGURES, 1.0), "x": zeros, "y": zeros,
        "racking": zeros, "x_c": 0.0,
    }  # fmt: skip


def test_each_damaged_byte_is_refused() -> None:
    data = signed(a_kernel())
    assert read(data) == a_kernel()
    for place in range(len(data)):
        for change in (1, 0x80):
            damaged = bytearray(data)
            damaged[place] ^= change
            with pytest.raises(ValueError, match="hframe-post identify"):
                read(bytes(damaged))
    for cut in range(len(data)):
        with pytest.raises(ValueError, match="hframe-post identify"):
            read(data[:cut])


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("x", [0.0]), ("x", [float("nan"), *[0.0] * (TAPS - 1)]), ("x", "text"), ("y", None),
        ("racking", [[0.0] * TAPS]), ("racking", [0.0]), ("racking", None), ("racking", 3),
        ("racking", [float("inf"), *[0.0] * (TAPS - 1)]), ("x_c", None), ("x_c", float("nan")),
        ("limits", 1), ("w", 1), ("limits", {"max_velocity": 1}),
    ],
)  # fmt: skip
def test_a_signed_file_of_something_else_is_refused(key: str, value: object) -> None:
    with pytest.raises(ValueError, match="something else"):
        read(signed({**a_kernel(), key: value}))
    with pytest.raises(ValueError, match="something else"):
        read(signed([value]))  # type: ignore[arg-type]
