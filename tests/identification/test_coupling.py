"""Printers whose modes move x and y together: what recordings share of it is found."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.coupling import Crossed, MeasuredCoupling, find_coupling, in_print
from hframe_post.identification.estimation import known_start
from hframe_post.identification.estimation.frequency_response import FrequencyResponse, advanced
from hframe_post.identification.estimation.regression import Estimated
from tests.coupled_printers import BAND, X_C, Coupled


@cache
def model(printer: Coupled, noise: float) -> Estimated:
    """Return the response of x to its command, on the delay of its recordings."""
    x, _ = printer.measured((1.0, 0.0), 0, noise=noise)
    found = known_start.estimated(advanced(_straight(x), printer.delay))
    return replace(found, delay=printer.delay)


def coupling(printer: Coupled, *others: Coupled, noise: float = 0.003) -> MeasuredCoupling:
    """Return what x does to y, from a recording of the printer and one of each of the others."""
    return at_places(tuple((each, X_C) for each in (printer, *others)), noise)


@cache
def at_places(
    recorded: tuple[tuple[Coupled, float], ...], noise: float = 0.003, known: int = 0
) -> MeasuredCoupling:
    """Return what x does to y, from recordings of printers at places (mm of x)."""
    runs = []
    for seed, (printer, place) in enumerate(recorded):
        x, y = printer.measured((1.0, 0.0), seed, place, noise)
        runs.append(Crossed(_straight(x), _straight(y), (place, 150.0)))
    return find_coupling("x", runs, model(recorded[0][0], noise), known)


def compensated(found: MeasuredCoupling, hz: Array, x: float = X_C) -> Complex:
    """Return what is compensated of x moving y at x (mm)."""
    known = np.zeros(len(hz), complex)
    for one in found.terms:
        lever = 1.0 if one.along is None else x - one.centre
        known += lever * one.G.response(2.0 * np.pi * hz * TS)
    return known


def moves(printer: Coupled, hz: Array, x: float = X_C) -> Complex:
    """Return what x does to y at x (mm) without the delay, by a command of straight lines."""
    true = printer.response(hz, x)[:, 1, 0] * np.exp(2j * np.pi * hz * printer.delay)
    return np.asarray(true * np.sinc(hz * TS) ** 2)


def _straight(response: FrequencyResponse) -> FrequencyResponse:
    """Return the response as if the command had been played as straight lines between samples."""
    return replace(response, H=response.H * np.sinc(response.hz * TS) ** 2)


def off(found: Complex, true: Complex) -> float:
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.05, -0.4])
def test_coupling_of_shared_modes_is_found_with_its_size(angle: float) -> None:
    printer = Coupled(angle=angle)
    found = coupling(printer, printer)
    assert found.counts
    hz = np.linspace(*BAND, 400)
    w = np.abs(hz / 50.0)
    true = moves(printer, hz)
    assert off(w * compensated(found, hz), w * true) < 0.05
    at = int(np.argmax(np.abs(true)))
    assert found.hz == pytest.approx(hz[at], abs=1.0)
    assert found.size == pytest.approx(np.abs(true[at]), rel=0.12)
    assert abs(np.degrees(found.turn)) < 0.4
    (one,) = found.terms
    assert one.G.dc_gain == 0.0
    assert "a command in x moves y by" in found.as_text()
    assert found.as_json()["size"] == found.size


@pytest.mark.slow
def test_a_turned_sensor_is_no_coupling() -> None:
    straight = Coupled(angle=0.0, turned=np.radians(11.0))
    found = coupling(straight, straight)
    assert np.degrees(abs(found.turn)) == pytest.approx(11.0, abs=0.4)
    assert found.size < 0.05
    assert "turned by 11°" in found.warnings()[0]
    both = coupling(*[Coupled(turned=np.radians(11.0))] * 2)
    alone = coupling(*[Coupled()] * 2)
    assert np.degrees(abs(both.turn)) == pytest.approx(11.0, abs=0.5)
    assert both.size == pytest.approx(alone.size, rel=0.1)
    assert not alone.warnings()


@pytest.mark.slow
def test_a_mode_that_neither_axis_shows_is_found_if_it_repeats() -> None:
    printer = Coupled(own=0.15)
    found = coupling(printer, printer)
    hz = np.linspace(*BAND, 400)
    assert off(compensated(found, hz), moves(printer, hz)) < 0.08
    near = hz[np.abs(hz - 75.0) < 4.0]
    for one in (printer, Coupled()):  # and none is made up
        found = coupling(one, one)
        assert off(compensated(found, near), moves(one, near)) < 0.08


@pytest.mark.slow
def test_coupling_counts_only_if_a_second_recording_shows_it() -> None:
    printer = Coupled()
    slight = coupling(*[Coupled(angle=0.003)] * 2)
    assert 0.0 < slight.size < 0.06
    assert slight.as_text() == "a command in x does not move y"
    other = coupling(printer, Coupled(angle=-0.2))
    assert not other.counts
    assert "does not repeat" in other.as_text()
    assert not other.terms
    noisy = coupling(printer, printer, noise=0.1)
    assert noisy.counts
    nothing = coupling(*[Coupled(angle=0.0)] * 2)
    assert not nothing.counts or nothing.size < 0.02


def errors(found: MeasuredCoupling, printer: Coupled, x: float) -> tuple[float, float]:
    """Return what a print feels of x moving y at x (mm), uncompensated and compensated."""
    hz = np.linspace(*BAND, 400)
    true = moves(printer, hz, x)
    return in_print(true, hz), in_print(true - compensated(found, hz, x), hz)


def test_what_is_shared_is_compensated() -> None:
    same = coupling(Coupled(), Coupled())
    before, after = errors(same, Coupled(), X_C)
    assert after < 0.05 * before
    assert "and is compensated" in same.as_text()
    (one,) = same.terms
    assert (one.answer, one.command, one.along) == (1, 0, None)
    assert abs(one.G.dc_gain) < 1e-12


@pytest.mark.slow
def test_of_couplings_that_differ_by_a_half_less_than_their_mean_is_compensated() -> None:
    (one,) = coupling(Coupled(), Coupled()).terms
    changed = coupling(Coupled(), Coupled(angle=0.12))
    mean = 0.5 * (np.sin(2 * 0.2) + np.sin(2 * 0.12)) / np.sin(2 * 0.2)
    (less,) = changed.terms
    size = np.abs(less.G.response(np.array([0.2])) / one.G.response(np.array([0.2])))[0]
    assert 0.8 * mean < size < 0.98 * mean
    for angle in (0.2, 0.12):
        before, after = errors(changed, Coupled(angle=angle), X_C)
        assert after < 0.5 * before


@pytest.mark.slow
def test_a_coupling_that_changes_along_x_is_found_from_three_places() -> None:
    printer = Coupled(racking=2e-8)
    found = at_places(tuple((printer, x) for x in (80.0, 140.0, 200.0)))
    assert {one.along for one in found.terms} == {None, 0}
    assert "changes along x, and is compensated" in found.as_text()
    for x in (80.0, 110.0, 200.0):
        before, after = errors(found, printer, x)
        assert after < 0.1 * before


@pytest.mark.slow
def test_a_change_along_x_is_not_found_twice_nor_from_two_places() -> None:
    # where racking is known from the same places, it is not found again
    without = at_places(tuple((Coupled(), x) for x in (80.0, 140.0, 200.0)), known=1)
    assert {one.along for one in without.terms} == {None}
    # two places tell a line, and not whether it is one
    two = at_places(tuple((Coupled(racking=2e-8), x) for x in (80.0, 200.0)))
    assert all(one.along is None for one in two.terms)
