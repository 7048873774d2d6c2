"""The modes of a response: their shares, their delay, and what is listed for people."""

import numpy as np
import pytest

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.estimation.fit import Fit, described, shares
from hframe_post.identification.estimation.frequency_response import FrequencyResponse
from hframe_post.identification.estimation.kernel import Mode
from hframe_post.model.impulse_response import ImpulseResponse
from tests import simulator
from tests.simulator import Axis, Machine

HZ = np.arange(3.0, 100.01, 0.25)
TWO = Machine(
    Axis((simulator.Mode(30.0, 0.05, 0.8), simulator.Mode(70.0, 0.04, 0.2)), delay=0.0013),
    Axis((simulator.Mode(38.0, 0.1),)),
    racking=2e-8,
)


def continuous(axis: Axis, hz: Array) -> Complex:
    s, G = 2j * np.pi * hz, np.zeros(len(hz), dtype=complex)
    for mode in axis.modes:
        w = 2.0 * np.pi * mode.hz
        G += mode.share * w * w / (s * s + 2.0 * mode.damping * w * s + w * w)
    return np.asarray(G * np.exp(-s * axis.delay) * np.sinc(hz * TS) ** 2)


MODES = [
    Mode(2.0 * np.pi * TS * hz, zeta) for hz, zeta in ((30.0, 0.05), (70.0, 0.04), (50.0, 0.06))
]


def seen(H: Complex, noise: float = 0.003) -> FrequencyResponse:
    real, imaginary = np.random.default_rng(3).normal(size=(2, len(HZ)))
    one = np.ones(len(HZ))
    return FrequencyResponse(HZ, H * (1.0 + noise * (real + 1j * imaginary)), 0.9999 * one, one)


@pytest.mark.parametrize("gain", [-0.95, 1.04])
def test_shares_and_delay_are_found(gain: float) -> None:
    """The third mode is not the printer's."""
    measured = seen(gain * continuous(TWO.x, HZ))
    sizes, delay = shares(measured, MODES, 0.5e-3, speed=False)
    assert delay == pytest.approx(0.0013, abs=3e-5)
    assert sizes == pytest.approx([0.8, 0.2, 0.0], abs=0.01)


def test_modes_are_listed_that_ring_and_count() -> None:
    damped = Mode(2.0 * np.pi * TS * 45.0, 0.5)
    expected = MODES[1], damped, MODES[2], MODES[0]
    found = Fit(ImpulseResponse(np.zeros(1), 0), 1.0, 0.0, 30.0, expected)
    modes = described(found, seen(continuous(TWO.x, HZ)), 0.0).modes
    assert np.array(modes) == pytest.approx(np.array([(30.0, 0.05), (70.0, 0.04)]))


@pytest.mark.parametrize(("hz", "zeta"), [(28.0, 0.05), (62.0, 0.1)])
def test_without_a_regression_the_main_resonance_is_listed(hz: float, zeta: float) -> None:
    G = ImpulseResponse.from_mode(hz, zeta)
    measured = seen(-1.1 * G.response(2.0 * np.pi * TS * HZ))
    ((at, damping),) = described(Fit(G, -1.1, 0.0, hz + 0.1), measured, 0.0).modes
    assert at == pytest.approx(hz, rel=0.025)  # damping lowers a peak
    assert damping == pytest.approx(zeta, rel=0.05)


def test_a_printer_that_does_not_ring_has_no_mode() -> None:
    stiff = Fit(ImpulseResponse(np.zeros(1), 0), 1.0, 0.0, 90.0)
    assert described(stiff, seen(np.ones(len(HZ), dtype=complex)), 0.0).modes == []
