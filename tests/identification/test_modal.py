"""Modes fitted to responses and discretized."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.arrays import TS, Complex
from hframe_post.identification.fitting.discrete import delayed
from hframe_post.identification.fitting.modal import Data, Modal, Structure, fit, structures
from hframe_post.model.impulse_response import transfer_function
from tests.identification.modal_tools import BAND, HZ, TWO, continuous


def data(H: Complex, noise: float = 0.003) -> Data:
    real, imaginary = np.random.default_rng(3).normal(size=(2, len(HZ)))
    measured = H * (1.0 + noise * (real + 1j * imaginary))
    weight = 1.0 / np.hypot(0.003 * np.abs(H), 0.002 * np.abs(H).max())
    return Data(HZ, measured, weight, BAND, (-1.6e-4, 5e-3))


@pytest.mark.parametrize("gain", [0.95, 1.0, 1.04])
def test_modes_delay_and_sensor_gain_are_found(gain: float) -> None:
    found = fit(data(gain * continuous(TWO.x, HZ)), Structure(2, False))
    assert found.gain == pytest.approx(gain, rel=0.003)
    assert np.sort(found.parameters.omega) / (2.0 * np.pi) == pytest.approx([30.0, 70.0], rel=2e-3)
    assert found.parameters.delay == pytest.approx(0.0013, abs=3e-5)


def test_one_mode_too_few_leaves_much_unexplained() -> None:
    one, two = (fit(data(continuous(TWO.x, HZ)), Structure(modes, False)).cost for modes in (1, 2))
    assert two < 0.01 * one


def test_the_discrete_model_responds_like_the_simulator() -> None:
    """The simulator's exact plant is discretized by scipy."""
    found = fit(data(continuous(TWO.x, HZ), 0.0), Structure(2, False))
    G = found.discrete(found.parameters.delay, found.gain)
    assert G.dc_gain == pytest.approx(1.0, abs=1e-9)
    hz = np.linspace(1.0, 100.0, 200)
    true = TWO.exact().Gxx.response(2.0 * np.pi * hz * TS)
    off = np.linalg.norm(G.response(2.0 * np.pi * hz * TS) - true) / np.linalg.norm(true)
    assert off < 2e-3


@pytest.mark.parametrize("samples", [1.0, 5.0 + 2e-8, 5.0 - 3e-5, 0.99])
def test_no_delay_needs_a_zero_that_a_profile_cannot_have(samples: float) -> None:
    G = delayed(transfer_function(TWO.exact().Gxx), samples)
    assert np.abs(G.zeros).max() < 1e5
    omega = 2.0 * np.pi * TS * np.linspace(1.0, 100.0, 50)
    late = -np.angle(G.response(omega) / TWO.exact().Gxx.response(omega)) / omega
    assert np.abs(np.mod(late - samples + np.pi, 2.0 * np.pi / omega) - np.pi).max() < 0.01


@pytest.mark.parametrize("zeros", [1, 2])
def test_racking_has_its_zeros_at_rest(zeros: int) -> None:
    exact = TWO.exact().Gxtheta
    assert exact is not None
    H = exact.response(2.0 * np.pi * HZ * TS)
    found = fit(data(H), Structure(3, True, 0, zeros))
    G = found.discrete(found.parameters.delay, 1.0)
    assert int((np.abs(G.zeros - 1.0) < 1e-9).sum()) == zeros
    off = np.linalg.norm(found.response(HZ) - H) / np.linalg.norm(H)
    assert off < 5e-3


def test_no_mode_leaves_its_range() -> None:
    """Not even for a measurement that no printer could make."""
    rng = np.random.default_rng(1)
    H = rng.normal(size=len(HZ)) + 1j * rng.normal(size=len(HZ))
    for structure in structures(False, 5):
        found: Modal = fit(data(H), structure)
        places = np.concatenate([found.parameters.omega, found.parameters.corner]) / (2.0 * np.pi)
        assert (places >= BAND[0] * 0.999).all()
        assert (places <= BAND[1] * 1.001).all()
