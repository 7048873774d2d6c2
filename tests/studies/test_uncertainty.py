"""Printers drawn around the model: repeatable, stable, at rest as they were."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.arrays import Array, Complex
from hframe_post.model.impulse_response import Linear, transfer_function
from hframe_post.model.plant import Plant
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.printer import profile
from hframe_post.studies.simulation.uncertainty import draws, perturbed
from tests.coupled import coupled_plant

PLANT = profile.load("paper").plant
CARTESIAN = profile.load("example-cartesian").plant
FACTORS = st.lists(st.floats(0.01, 1.99), min_size=9, max_size=9)


def functions(plant: Plant) -> list[TransferFunction]:
    return [transfer_function(G) for G in (plant.Gxx, plant.Gyy, plant.Gxtheta) if G is not None]


def same(one: Plant, other: Plant) -> bool:
    return one.x_c == other.x_c and all(
        np.array_equal(G.zeros, H.zeros) and np.array_equal(G.poles, H.poles) and G.gain == H.gain
        for G, H in zip(functions(one), functions(other), strict=True)
    )


def ringing(roots: Complex) -> Complex:
    """ln z of the roots that ring, those above the real axis."""
    return np.log(roots[roots.imag > 1e-9])


def slope(G: Linear) -> float:
    """θ per speed at rest: the derivative of G at z = 1, by a difference."""
    omega = 1e-5
    return float((G.response(np.array([omega]))[0] / (1j * omega)).real)


def unit(share: float, count: int) -> Array:
    """Frequency and damping factors of each axis, (count, 2, 2), from the drawn poles."""
    rows = []
    for plant in draws(PLANT, share, count, seed=3):
        axes = []
        for drawn, G in ((plant.Gxx, PLANT.Gxx), (plant.Gyy, PLANT.Gyy)):
            s, s_0 = (ringing(transfer_function(each).poles)[0] for each in (drawn, G))
            frequency = abs(s) / abs(s_0)
            axes.append([frequency, s.real / s_0.real / frequency])
        rows.append(axes)
    return np.array(rows)


def test_couplings_move_too_and_leave_the_axes_alone() -> None:
    coupled = replace(PLANT, cross=coupled_plant(1).cross)
    for one, other in zip(draws(coupled, 0.1, 8, 1), draws(PLANT, 0.1, 8, 1), strict=True):
        assert same(one, other)
        for moved, own in zip(one.cross, coupled.cross, strict=True):
            assert moved.G.dc_gain == 0.0
            after, before = (transfer_function(each.G).poles[:4] for each in (moved, own))
            off = np.abs(np.log(after)) / np.abs(np.log(before))
            assert np.allclose(off, off[0])
            assert 0.9 <= off[0] <= 1.1


def test_equal_seeds_give_equal_printers_and_others_do_not() -> None:
    first, again = (draws(PLANT, 0.05, 8, seed=1) for _ in range(2))
    assert all(same(a, b) for a, b in zip(first, again, strict=True))
    assert not any(same(a, b) for a, b in zip(first, draws(PLANT, 0.05, 8, 2), strict=True))
    assert not any(same(a, b) for a, b in pairwise(first))


@pytest.mark.parametrize("plant", [PLANT, CARTESIAN], ids=["hbot", "cartesian"])
def test_no_model_error_is_the_plant_itself(plant: Plant) -> None:
    for drawn in draws(plant, 0.0, 3, seed=0):
        assert (drawn.x_c, drawn.Gxtheta is None) == (plant.x_c, plant.Gxtheta is None)
        for G, H in zip(functions(drawn), functions(plant), strict=True):
            np.testing.assert_allclose(G.zeros, H.zeros, atol=1e-12)
            np.testing.assert_allclose(G.poles, H.poles, atol=1e-12)
            assert G.gain == pytest.approx(H.gain, rel=1e-4)  # as a profile's is


@given(FACTORS)
def test_any_factors_leave_a_stable_real_printer_that_stands_still(factors: list[float]) -> None:
    for plant in (PLANT, CARTESIAN):
        drawn = perturbed(plant, np.array(factors).reshape(3, 3))
        for G in functions(drawn):  # which a TransferFunction would refuse otherwise
            assert np.abs(G.poles).max() < 1.0
        assert drawn.Gxx.dc_gain == pytest.approx(1.0, abs=1e-9)
        assert drawn.Gyy.dc_gain == pytest.approx(1.0, abs=1e-9)
        if drawn.Gxtheta is not None:
            assert drawn.Gxtheta.dc_gain == pytest.approx(0.0, abs=1e-9)


@given(FACTORS)
def test_each_transfer_function_moves_by_its_own_factors(factors: list[float]) -> None:
    """Natural frequency and damping ratio of all that rings, poles and zeros alike."""
    f = np.array(factors).reshape(3, 3)
    drawn = perturbed(PLANT, f)
    moved = zip(functions(drawn), functions(PLANT), f, strict=True)
    for G, H, (frequency, damping, _) in moved:
        for roots, before in ((G.poles, H.poles), (G.zeros, H.zeros)):
            s, s_0 = ringing(roots), ringing(before)
            s, s_0 = s[np.argsort(np.abs(s))], s_0[np.argsort(np.abs(s_0))]
            ratio = np.clip(damping * s_0.real / np.abs(s_0), -0.999, 0.999)
            np.testing.assert_allclose(np.abs(s), frequency * np.abs(s_0), rtol=1e-9)
            np.testing.assert_allclose(s.real / np.abs(s), ratio, atol=1e-9)


def test_parameters_are_uniform_within_the_share() -> None:
    share, count = 0.05, 400
    off = (unit(share, count).reshape(count, 4) - 1.0) / share
    assert np.abs(off).max() <= 1.0 + 1e-9
    assert np.abs(off).max(axis=0).min() > 0.97
    spread = 1.0 / np.sqrt(3.0)
    assert np.abs(off.mean(axis=0)).max() < 4.0 * spread / np.sqrt(count)
    np.testing.assert_allclose(off.std(axis=0), spread, rtol=0.1)
    quartiles = np.quantile(off, [0.25, 0.5, 0.75], axis=0)
    np.testing.assert_allclose(quartiles, np.array([[-0.5], [0.0], [0.5]]).repeat(4, 1), atol=0.15)
    correlation = np.corrcoef(off.T) - np.eye(4)
    assert np.abs(correlation).max() < 4.0 / np.sqrt(count)
