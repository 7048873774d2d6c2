"""The impulse response of an axis, from what TEST_RESONANCES showed of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hframe_post as hp
from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation.fit import Fit
from hframe_post.identification.estimation.frequency_response import FrequencyResponse, share_left
from hframe_post.identification.estimation.response import fit_unknown_start, with_an_ideal_mode
from hframe_post.identification.identify import DRIFT, DRIFT_ALONE, Identified
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.model.shapers import shaper
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.predict import judge
from hframe_post.prediction.statistics import ContourErrors
from hframe_post.stream.types import Samples
from tests.plants import axis_mode
from tests.simulator import Axis, Machine, Mode

# a published CoreXY, x (0) and y (1) on the first day and 18 days later
REAL = Path(__file__).with_name("data") / "corexy_18_days_apart.npz"
HZ = np.arange(5.0, 100.0, 0.125)
Axes = tuple[ImpulseResponse, ImpulseResponse]
AVERAGES = 17.0  # of these recordings, which take 131 s


def real(day: int) -> list[FrequencyResponse]:
    responses = []
    with np.load(REAL) as held:
        for axis in "xy":
            hz, re, im, coherence, power = held[f"{axis}_{day}"].astype(float)
            responses.append(FrequencyResponse(hz, re + 1j * im, coherence, power, AVERAGES))
    return responses


def drawn(gain: float, delay: float, noise: float) -> tuple[FrequencyResponse, Complex]:
    """Return a measured response of two modes, and the true one at HZ."""
    omega = 2.0 * np.pi * TS * HZ
    true = 0.8 * axis_mode(46.0, 0.06).response(omega) + 0.2 * axis_mode(71.0, 0.05).response(omega)
    rng = np.random.default_rng(3)
    off = noise * (rng.normal(size=len(HZ)) + 1j * rng.normal(size=len(HZ))) / np.sqrt(2.0)
    late = np.exp(-2j * np.pi * HZ * delay)
    coherence = np.full(len(HZ), 1.0 / (1.0 + noise**2))
    H = gain * late * true * (1.0 + off)
    return FrequencyResponse(HZ, H, coherence, np.ones(len(HZ)), AVERAGES), true


def fitted(measured: FrequencyResponse) -> Fit:
    return fit_unknown_start({"Gxx": measured})["Gxx"]


def test_gain_delay_and_response_are_found() -> None:
    measured, true = drawn(-1.12, 2.3e-3, 0.05)
    found = with_an_ideal_mode(measured)
    assert found.gain == pytest.approx(-1.12, rel=0.05)
    assert found.delay == pytest.approx(2.3e-3, abs=2e-4)  # s
    assert found.resonance_hz == pytest.approx(46.0, abs=0.5)
    assert share_left(found.response(HZ), measured, measured.power) < 0.07
    G = found.G.response(2.0 * np.pi * TS * HZ)
    counts = (HZ > 0.42 * 46.0) & (HZ < 95.0)
    off = np.abs(G - true * np.exp(2j * np.pi * HZ * (found.delay - 2.3e-3)) * -1.12 / found.gain)
    assert off[counts].max() < 0.06 * np.abs(true).max()


def test_below_the_resonance_it_is_one_ideal_mode() -> None:
    found = with_an_ideal_mode(drawn(1.0, 0.0, 0.05)[0])
    hz = np.arange(0.5, 0.25 * found.resonance_hz, 0.5)
    off = found.G.response(2.0 * np.pi * TS * hz) - 1.0 / (1.0 - (hz / found.resonance_hz) ** 2)
    assert np.abs(off).max() < 2e-3  # of the command
    # of what 5000 mm/s² moves the nozzle by: strokes of a bed's length are as slow
    assert 5.0 * np.abs(off / (2.0 * np.pi * TS * hz) ** 2).max() < 3.0  # µm, of 60
    assert found.G.dc_gain == 1.0


def test_a_test_that_shows_nothing_below_the_resonance_is_refused() -> None:
    measured, _ = drawn(1.0, 0.0, 0.01)
    with pytest.raises(IdentificationError, match="begin the test at a lower frequency"):
        with_an_ideal_mode(measured.within((30.0, 95.0)))
    with pytest.raises(IdentificationError, match="too few"):
        with_an_ideal_mode(measured.within((30.0, 31.0)))


@pytest.mark.slow
@pytest.mark.parametrize(
    "modes", [((46.0, 0.06, 0.8), (71.0, 0.05, 0.2)), ((24.0, 0.03, 1.0),)], ids=["two", "sharp"]
)
def test_a_linear_printer_is_as_late_as_its_damping_explains(
    modes: tuple[tuple[float, float, float], ...],
) -> None:
    """A sharp mode, too, which rings for longer than a response with an ideal mode lasts."""
    axis = Axis(tuple(Mode(*mode) for mode in modes), delay=0.0)
    true = Machine(axis, axis).exact().Gxx.response(2.0 * np.pi * TS * HZ)
    late = np.exp(-2j * np.pi * HZ * 2.3e-3)
    one, rng = np.ones(len(HZ)), np.random.default_rng(3)
    off = 0.01 * (rng.normal(size=len(HZ)) + 1j * rng.normal(size=len(HZ))) / np.sqrt(2.0)
    found = fitted(
        FrequencyResponse(HZ, -1.12 * late * true * (1.0 + off), 0.9999 * one, one, 17.0)
    )
    assert found.gain == pytest.approx(-1.12, rel=0.01)
    by_damping = sum(share * 2.0 * zeta / hz for hz, zeta, share in modes)  # over 2π, s
    assert found.G.lag * TS == pytest.approx(by_damping / (2.0 * np.pi), abs=5e-5)
    assert found.delay == pytest.approx(2.3e-3, abs=2e-5)
    off = np.abs(found.G.response(2.0 * np.pi * TS * HZ) - true)
    assert off.max() < 0.02 * np.abs(true).max()
    assert np.array(found.modes) == pytest.approx(np.array(modes)[:, :2], rel=0.05)


@pytest.mark.slow
def test_a_real_printer_follows_its_command_below_the_resonance_and_may_drift() -> None:
    x, _ = real(1)
    fitted_x = fitted(x)
    assert fitted_x.G.lag == 0.0
    assert fitted_x.residual < 0.15
    fits = {"Gxx": fitted_x}
    found = Identified({}, fits, None, False, False, {})
    plant = found.plant(100.0)
    assert isinstance(plant.Gxx, ImpulseResponse)
    assert plant.Gxx.drift == DRIFT_ALONE == 0.03
    fits["Gxx"] = replace(fits["Gxx"], G=replace(plant.Gxx, drift=0.0, unknown=np.ones(1)))
    plant = found.plant(100.0)
    assert isinstance(plant.Gxx, ImpulseResponse)
    assert plant.Gxx.drift == DRIFT == 0.02
    assert plant.Gyy.dc_gain == 1.0  # not measured: follows its command


@pytest.mark.slow
def test_if_one_axis_is_not_linear_the_start_of_both_is_unknown() -> None:
    """One lags at low speed, and one whose start is unknown does not."""
    x, _ = real(1)
    y, _ = drawn(1.0, 0.0, 0.01)
    found = fit_unknown_start({"Gxx": x, "Gyy": y})
    for one in found.values():
        assert one.G.lag == 0.0


def moved(G: ImpulseResponse, command: Array) -> Array:
    """Return where the nozzle goes, by convolution."""
    a = np.diff(np.pad(command, 1, mode="edge"), n=2)
    return np.asarray(command + np.convolve(a, G.deviation)[G.lead :][: len(command)])


def contour(G: Axes, commands: Array, path: Array) -> float:
    """Return the RMS distance (µm) of the nozzle from the path, all (n, 2), in its middle."""
    x, y = (moved(*each) for each in zip(G, commands.T, strict=True))
    away = np.abs(np.array([x - path[:, 0].min(), x - path[:, 0].max(),
                            y - path[:, 1].min(), y - path[:, 1].max()])).min(axis=0)  # fmt: skip
    return float(1e3 * np.sqrt((away[500:-500] ** 2).mean()))


def identified(day: int) -> Axes:
    """Return the responses of x and y as found in the recordings of a day."""
    x, y = (with_an_ideal_mode(one).G for one in real(day))
    return x, y


def compensated(known: Axes, path: Array) -> tuple[Array, Array]:
    """Return the commands for a path on a printer of these responses, and the path around them."""
    base = hp.load_printer("example-corexy")
    compensation = replace(base.compensation, effort=(10.0, 10.0))
    plant = Plant(*known, None, 0.0)
    printer = replace(base, plant=plant, compensation=compensation, invented=False)
    ours = np.asarray(hp.compensate(path + 50.0, printer, strategy="fbs")) - 50.0
    pad = (len(ours) - len(path)) // 2
    return ours, np.pad(path, ((pad, pad), (0, 0)), mode="edge")


def outline(acceleration: float = 10000.0, speed: float = 150.0) -> Array:
    """Return a rectangle of 120 × 20 mm, twice around, each ms, with a stop at every corner."""
    xy = [np.zeros((1000, 2))]
    for dx, dy in [(120.0, 0.0), (0.0, 20.0), (-120.0, 0.0), (0.0, -20.0)] * 2:
        length, ramp = abs(dx) + abs(dy), speed / acceleration
        t = np.arange(0.0, length / speed + ramp, TS)
        v = np.minimum(np.minimum(t, t[-1] - t) * acceleration, speed)
        along = np.cumsum(v) / v.sum()
        xy.append(xy[-1][-1] + along[:, None] * [dx, dy])
    return np.concatenate([*xy, np.tile(xy[-1][-1], (1000, 1))])


def best_shaper(G: ImpulseResponse, path: Array) -> Array:
    """Return the path as the shaper that follows it best on G would shape it."""

    def off(shaped: Array) -> float:
        nozzle, lags = moved(G, shaped), range(-20, 60)
        return min(float(np.square(np.roll(nozzle, -lag) - path).sum()) for lag in lags)

    found = [
        shaper(name, hz, 0.1) for name in ("zv", "mzv", "ei") for hz in np.arange(27.0, 90.0, 6.0)
    ]
    return min((one.run(path) for one in found), key=off)


def test_the_error_of_another_day_is_in_the_predicted_range() -> None:
    """Of 18 days later; the range is at most three times as wide as needed."""
    x, y = (replace(G, drift=DRIFT_ALONE) for G in identified(1))
    plant = Plant(x, y, None, 0.0)
    for acceleration in (5000.0, 10000.0):
        ours, around = compensated((x, y), outline(acceleration))
        off = contour(identified(2), ours, around)
        xyze = np.column_stack([around, np.zeros((len(around), 2))])
        chunk = Samples(0, xyze, np.zeros(len(xyze), np.int64), (), {"fbs": ours}, True)
        errors = ContourErrors()
        for judgement in judge([chunk], plant, 1, Doubts.from_plant(plant)):
            errors.add(judgement.contour["fbs"], judgement.extruding)
            extruding = judgement.extruding[judgement.doubtful]
            errors.doubt(judgement.products["fbs"], extruding)
        foreseen = errors.range
        assert foreseen is not None
        moving = np.sqrt(errors.all.count / (len(around) - 1000))  # contour counts rests, too
        low, high = 1e3 * moving * foreseen.low, 1e3 * moving * foreseen.high
        assert low <= off <= high <= 3.0 * off, f"{off:.2f} µm RMS, {low:.2f} to {high:.2f}"


@pytest.mark.slow
@pytest.mark.parametrize("first", [1, 2])
def test_one_day_foresees_another_better_than_the_best_shaper(first: int) -> None:
    """Identified on one day, judged by the response of 18 days later or before."""
    known, truth, path = identified(first), identified(3 - first), outline()
    ours, around = compensated(known, path)
    shaped = np.column_stack([best_shaper(G, axis) for G, axis in zip(known, path.T, strict=True)])
    none, by_shaper, by_us = (
        contour(truth, command, each)
        for command, each in ((path, path), (shaped, path), (ours, around))
    )
    assert by_us < 0.6 * by_shaper, f"{by_us:.1f}, shaper {by_shaper:.1f}, none {none:.1f} µm RMS"
    assert by_us < 0.2 * none
