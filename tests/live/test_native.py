"""The C of the extras module against numpy, on drawn trapezoids in a queue of Klipper's own."""

import importlib
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BSpline

from hframe_post.firmware.klipper.live import kernel_file, live_kernel
from hframe_post.hosts.klipper.kernel_file import library, read, taps
from hframe_post.printer.profile import load

STRUCTS = """
    struct list_node { struct list_node *next, *prev; };
    struct move { double print_time, move_t, start_v, half_accel, start[3], axes_r[3];
                  struct list_node node; };
    struct kinematics { double step_dist, commanded_pos; void *sc; double flush, last_move;
                        void *tq; int active_flags; double pre, post;
                        double (*calc)(struct kinematics *, struct move *, double); void *cb; };
"""
BEGIN = 10.0  # s, of the first move


@cache
def declare(ffi: Any) -> None:
    ffi.cdef(STRUCTS)


class Stepper:
    """A motor of x, or of y, behind our kinematics; travel: of the bed, mm to each side."""

    def __init__(self, axis: str, name: str = "example-corexy", travel: float = 1e4) -> None:
        data = kernel_file(replace(load(name), invented=False))
        assert data is not None
        chelper = importlib.import_module("klippy.chelper")
        (self.ffi, self.lib), (_, self.main_lib) = library(chelper), chelper.get_ffi()
        declare(self.ffi)
        self.taps = taps(self.ffi, read(data), [(-travel, travel)] * 2)
        self.orig = self.main_lib.cartesian_stepper_alloc(axis.encode())
        self.trapq = self.main_lib.trapq_alloc()
        self.main_lib.itersolve_set_trapq(self.orig, self.trapq)
        ours = self.lib.hframe_live_alloc(self.orig, self.taps)
        self.pointer = self.ffi.gc(ours, self.lib.free)
        self.lib.hframe_live_reset(self.pointer)
        self.sk = self.ffi.cast("struct kinematics *", self.pointer)

    def append(self, time: float, phases: tuple[float, float, float], start: Any, way: Any,
               speeds: tuple[float, float, float]) -> None:  # fmt: skip
        self.main_lib.trapq_append(self.trapq, time, *phases, *start, 0.0, *way, 0.0, *speeds)

    def listed(self) -> list[Any]:
        """Return all moves in the queue, without sentinels."""
        self.main_lib.itersolve_check_active(self.orig, 0.0)  # sets the end of the queue
        ffi = self.ffi
        root = ffi.cast("struct list_node *", self.trapq)
        offset, node, moves = ffi.offsetof("struct move", "node"), root.next, []
        while node != root:
            moves.append(ffi.cast("struct move *", ffi.cast("char *", node) - offset))
            node = node.next
        return moves

    def at(self, time: float) -> float:
        moves = self.listed()[1:]
        move = next(m for m in moves if time <= m.print_time + m.move_t)
        return float(self.sk.calc(self.sk, move, time - move.print_time))


def drawn(seed: int, steppers: list[Stepper], seconds: float = 3.0) -> tuple[Any, Any]:
    """Append moves of random lengths at random accelerations; return path samples, from 8 s on."""
    rng = np.random.default_rng(seed)
    time, place = BEGIN, np.array([100.0, 120.0])
    rows = []
    while time < BEGIN + seconds:
        angle, v = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(20.0, 200.0)
        way, a = np.array([np.cos(angle), np.sin(angle)]), rng.uniform(1000.0, 10000.0)
        ramp, cruise = v / a, rng.choice([0.0, 0.002, 0.1, -1e-18])  # the last by rounding
        rows.append((time, ramp, cruise, place, way, v, a))
        for stepper in steppers:
            stepper.append(time, (ramp, cruise, ramp), place, way, (0.0, v, a))
        place = place + way * v * (ramp + cruise)
        time += 2.0 * ramp + cruise
        time += float(rng.choice([0.0, 0.05]))
    t = np.arange(8000, int(1000 * time) + 1500) * 1e-3
    path = np.tile(rows[0][3], (len(t), 1))
    for begin, ramp, cruise, start, way, v, a in rows:
        s = np.clip(t - begin, 0.0, 2.0 * ramp + cruise)
        up, down = np.minimum(s, ramp), np.maximum(s - ramp - cruise, 0.0)
        along = a * up**2 / 2.0 + v * np.clip(s - ramp, 0.0, cruise) + v * down - a * down**2 / 2.0
        path = np.where((t >= begin)[:, None], start + along[:, None] * way, path)
    return t, path


def spline(t: Any, c: Any, at: Any) -> Any:
    """Return the cubic B-spline of control points (n, 2) at t (n,) at other times, all in s."""
    knots = 1e3 * t[0] - 2.0 + np.arange(len(t) + 4)
    return BSpline(knots, c, 3)(1e3 * at)


@pytest.mark.parametrize(("name", "order"), [("paper", "any"), ("example-corexy", "forward")])
def test_the_c_is_the_kernel_at_all_times(name: str, order: str) -> None:
    made, _ = live_kernel(replace(load(name), invented=False))
    steppers = [Stepper(axis, name) for axis in "xy"]
    t, path = drawn(1, steppers)
    wanted = made.command(path)
    at = np.random.default_rng(2).uniform(9.0, t[-1] - 0.3, 300)
    if order == "forward":
        at = np.sort(at)
    found = np.array([[stepper.at(float(one)) for stepper in steppers] for one in at])
    assert np.abs(found - spline(t, wanted, at)).max() < 1e-8


def test_travel_limits_the_command_but_not_the_path() -> None:
    stepper = Stepper("x", travel=150.0)
    way = (1.0, 0.0)
    stepper.append(BEGIN, (0.05, 0.15, 0.05), (120.0, 50.0), way, (0.0, 150.0, 3000.0))  # to 150
    at = np.arange(BEGIN, BEGIN + 1.0, 2e-4)
    found = np.array([stepper.at(float(one)) for one in at])
    assert found.max() <= 150.0 + 1e-9
    assert found[-1] == pytest.approx(150.0, abs=1e-9)


def test_before_the_begin_nothing_moves() -> None:
    """After a change in mid-print, what came before does not reach into the command."""
    stepper = Stepper("x")
    for k, start in enumerate((10.0, 40.0)):
        time = BEGIN + 0.5 * k
        stepper.append(time, (0.05, 0.15, 0.05), (start, 50.0), (1.0, 0.0), (0.0, 150.0, 3000.0))
    stepper.sk.flush = BEGIN + 0.25  # the first move has just ended
    stepper.lib.hframe_live_reset(stepper.pointer)
    assert stepper.at(BEGIN + 0.251) == pytest.approx(40.0, abs=1e-9)
    assert stepper.at(BEGIN + 0.4) == pytest.approx(40.0, abs=1e-9)
    assert stepper.at(BEGIN + 2.0) == pytest.approx(70.0, abs=1e-9)


def test_a_command_at_a_coordinate_is_klippers() -> None:
    stepper = Stepper("y")
    ours = stepper.pointer
    assert stepper.main_lib.itersolve_calc_position_from_coord(ours, 3.0, 4.0, 5.0) == 4.0
