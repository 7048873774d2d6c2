"""Responses that change along x: between places, applied to streams, and compensated."""

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import TS, Array, X
from hframe_post.model.impulse_response import Elsewhere, ImpulseResponse
from hframe_post.model.nozzle import Response, nozzle
from hframe_post.model.plant import Plant
from hframe_post.model.strategies import Compensator, strategy
from hframe_post.prediction.predict import contour_error
from hframe_post.printer.profile import load
from tests.conftest import few
from tests.modes import deviation_of_mode
from tests.quantities import below

MIDDLE_X, AWAY = 140.0, 110.0  # mm
WINDOWS = load("paper").compensation.windows
HZ, DAMPING, CHANGE = 25.0, 0.05, 0.09  # CHANGE: of the frequency, from the middle to a place


def mode(hz: float, rest: float = 1.0, size: float = 1.0) -> ImpulseResponse:
    return ImpulseResponse(size * deviation_of_mode(hz, DAMPING, 700), 0, rest, lag=2.0 * rest)


def moving(change: float = CHANGE, hz: float = HZ) -> ImpulseResponse:
    """Return one mode, whose frequency is proportional to x, measured at three places."""
    ends = [
        Elsewhere(MIDDLE_X + side * AWAY, 1.0 + side * change, mode(hz * (1.0 + side * change)))
        for side in (-1.0, 1.0)
    ]
    return replace(mode(hz), x=MIDDLE_X, elsewhere=tuple(ends))


def racking(change: float) -> ImpulseResponse:
    middle, left, right = (mode(50.0 * f, 0.0, 2e-5) for f in (1.0, 1.0 - change, 1.0 + change))
    ends = (
        Elsewhere(MIDDLE_X - AWAY, 1.0 - change, left),
        Elsewhere(MIDDLE_X + AWAY, 1.0 + change, right),
    )
    return replace(middle, x=MIDDLE_X, elsewhere=ends)


def plant(change: float = CHANGE) -> Plant:
    return Plant(moving(change), moving(change, 38.0), racking(change), MIDDLE_X)


def rectangle(left: float, width: float) -> Array:
    """Return a path (n, 2), mm, at 150 mm/s and 10 000 mm/s², at rest at its corners."""

    def line(length: float) -> Array:
        speed = np.minimum(np.arange(1.0, 1.0 + 1e3 * length / 150.0) * 10.0, 150.0)
        speed = np.minimum(speed, speed[::-1])
        return np.asarray(np.cumsum(speed) * length / speed.sum())

    corners = np.array([(left, 137.0), (left + width, 137.0), (left + width, 157.0), (left, 157.0)])
    path = [np.tile(corners[:1], (500, 1))]
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        path.append(a + (b - a) * line(float(np.hypot(*(b - a))))[:, None] / np.hypot(*(b - a)))
    return np.concatenate([*path, np.tile(corners[:1], (500, 1))])


def compensated(made_for: Plant, path: Array, cuts: int = 1) -> Array:
    compensator = Compensator(made_for, WINDOWS)
    state = strategy("racking").begin(compensator, path[0])
    made = [state.feed(piece) for piece in np.array_split(path, cuts)]
    return np.concatenate([*made, state.finish()])


def left_over(printer: Plant, path: Array, command: Array) -> float:
    """Return the contour error, µm RMS."""
    error = contour_error(path, nozzle(printer, path[0], command))
    return 1e3 * float(np.sqrt((error**2).mean()))


def test_between_places_a_mode_moves_and_does_not_become_two() -> None:
    omega = 2.0 * np.pi * TS * np.arange(2.0, 80.0, 0.25)
    G = moving()
    for x in (65.0, 100.0, 190.0, 270.0):
        near = G.nodes[G.node(x)][0]
        frequency = HZ * (1.0 + CHANGE * (near - MIDDLE_X) / AWAY)
        wanted, found = (one.response(omega) for one in (mode(frequency), G.at(x)))
        off = float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))
        below(off, 0.01, f"relative error of the response at x = {near:g} mm")


def test_the_nozzle_follows_the_mix_of_both_neighbours() -> None:
    path = rectangle(30.0, 200.0)
    printer = replace(plant(), Gxtheta=None)
    found = nozzle(printer, path[0], path)
    outputs = [nozzle(printer.at(x), path[0], path) for x, _ in printer.Gxx.nodes]
    places = np.array([x for x, _ in printer.Gxx.nodes])
    weights = np.array([np.interp(path[:, X], places, one) for one in np.eye(len(places))])
    wanted = np.einsum("kn,knc->nc", weights, np.array(outputs))
    assert found == pytest.approx(wanted, abs=1e-9)


def test_streams_are_the_same_wherever_they_are_cut() -> None:
    path, printer = rectangle(30.0, 60.0), plant()
    whole = Response(printer, path[0]).run(path)
    response, pieces = Response(printer, path[0]), np.array_split(path, 37)
    assert np.array_equal(np.concatenate([response.run(piece) for piece in pieces]), whole)
    assert np.array_equal(compensated(printer, path, 41), compensated(printer, path))


@pytest.mark.parametrize("left", few([10.0, 80.0, 150.0], 1))
def test_it_is_compensated_as_well_as_a_printer_that_does_not_change(left: float) -> None:
    path, printer = rectangle(left, 120.0), plant()
    still = plant().at(left + 60.0)
    alike = left_over(still, path, compensated(still, path))
    one_model = left_over(printer, path, compensated(printer.at(MIDDLE_X), path))
    found = left_over(printer, path, compensated(printer, path))
    below(found, 1.3 * alike, "contour error of the rectangle, µm RMS")
    below(found, 0.7 * one_model, "contour error of the rectangle, µm RMS")


def test_places_may_ring_for_longer_or_shorter() -> None:
    path, G = rectangle(30.0, 60.0), moving()
    left, right = G.elsewhere
    short = replace(right, G=replace(right.G, deviation=right.G.deviation[:150]))
    printer = replace(plant(), Gxx=replace(G, elsewhere=(left, short)), Gxtheta=None)
    command = compensated(printer, path)
    below(left_over(printer, path, command), 5.0, "contour error of the rectangle, µm RMS")
