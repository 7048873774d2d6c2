"""What is made of a response: its modes, what is listed and shown of it, and windows."""

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.estimation.fit import Fit, described, shares
from hframe_post.identification.estimation.frequency_response import FrequencyResponse
from hframe_post.identification.estimation.regression import FIRST, Mode, Prior
from hframe_post.identification.report import uncertain
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.printer.profile import load
from hframe_post.printer.settings import GuessedMotors, Motors
from hframe_post.studies.tuning import recommend
from tests import simulator
from tests.plants import axis_mode, deviation_of_mode
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
    found = Fit(ImpulseResponse(np.zeros(1), 0), 1.0, 0.0, 30.0, Prior(FIRST, expected))
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


PAGE_HZ = np.arange(5.0, 100.0, 5.0)


def test_the_band_is_what_drift_and_doubt_make_of_the_response() -> None:
    G = ImpulseResponse.from_transfer_function(axis_mode(40.0, 0.1), 1.0)
    omega = 2.0 * np.pi * TS * PAGE_HZ
    changed = (G.stretched(1.001).response(omega) - G.response(omega)) / 0.001
    drifts = uncertain(replace(G, drift=0.03), PAGE_HZ)
    assert drifts == pytest.approx(0.03 * np.abs(changed), rel=0.05)
    both = uncertain(replace(G, drift=0.03, unknown=np.array([0.5])), PAGE_HZ)
    alone = 0.5 * (2.0 * np.sin(omega / 2.0)) ** 2
    assert both == pytest.approx(np.hypot(drifts, alone), rel=1e-9)


PLANT = Plant(
    ImpulseResponse(deviation_of_mode(45.0, 0.06, 400), 0, drift=0.02),
    ImpulseResponse(deviation_of_mode(32.0, 0.08, 400), 0, drift=0.02),
    None,
    100.0,
)


@pytest.mark.parametrize(("belts", "guessed"), [(60000.0, True), (5300.0, False)])
def test_measured_responses_get_one_window_whatever_the_belts(belts: float, guessed: bool) -> None:
    """The path is kept within stated motors; a guess grows with the file that is converted."""
    stated, guess = Motors(1000.0, belts), GuessedMotors(1000.0, belts, (1000.0, belts))
    printer = replace(load("example-corexy"), motors=guess if guessed else stated)
    found = recommend(PLANT, printer, 0.03)
    assert found is not None
    window = Window(5, 88, 44, 10.0)
    assert found.windows == (window, window)
    assert found.rms("fbs") < 0.1 * found.rms("none")  # µm
