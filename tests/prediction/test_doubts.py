"""The range of a predicted error: what other printers of the same model do with the command."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import Array, X, Y
from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.model.error_range import SUMS, error_range, products
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant, nozzle
from hframe_post.prediction.doubts import EVERY, Doubts
from hframe_post.prediction.predict import judge
from hframe_post.prediction.statistics import ContourErrors
from hframe_post.prediction.windows import around
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Samples
from hframe_post.studies.tuning import rectangle
from tests.paths import ORIGIN, strokes
from tests.plants import deviation_of_mode

AXES = ((X, 0.02), (Y, 0.03))  # and their drift


def mode(hz: float, drift: float = 0.0, unknown: Sequence[float] = ()) -> ImpulseResponse:
    return ImpulseResponse(
        deviation_of_mode(hz, 0.08, 500), 0, lag=0.4, drift=drift, unknown=np.array(unknown)
    )


def racking(drift: tuple[float, float]) -> Plant:
    """Return a plant that racks by its lever arm."""
    theta = replace(mode(38.0), deviation=3e-4 * mode(38.0).deviation, rest=0.0, lag=0.0)
    return Plant(mode(43.0, drift[X]), mode(31.0, drift[Y]), theta, 140.0)


def along(doubts: Doubts, command: Array) -> tuple[Array, Array]:
    """Return drift and unknown part at every EVERYth sample of a command, which is the path."""
    place = command[::EVERY]
    last = EVERY * (len(place) - 1)
    return doubts.at(around(command, -doubts.past, last + doubts.ahead + 1), place)


@pytest.mark.parametrize(("axis", "drift"), AXES)
def test_drift_moves_the_nozzle_as_another_printer_does(axis: int, drift: float) -> None:
    """With all that the axis' command does, through the lever arm of racking, too."""
    plant = racking((AXES[X][1], AXES[Y][1]))
    doubts = Doubts.from_plant(plant)
    assert doubts is not None
    command = np.pad(strokes(), ((0, 500), (0, 0)), mode="edge")
    moved, _ = along(doubts, command)

    def stretched(factor: float) -> Plant:
        def one(G: object) -> ImpulseResponse:
            assert isinstance(G, ImpulseResponse)
            return G.stretched(factor)

        if axis == X:
            return replace(plant, Gxx=one(plant.Gxx), Gxtheta=one(plant.Gxtheta))
        return replace(plant, Gyy=one(plant.Gyy))

    places = (nozzle(stretched(factor), ORIGIN, command) for factor in (1.001, 0.999))
    change = np.subtract(*places)[::EVERY] * drift / 0.002
    size = np.abs(change).max()
    assert np.abs(change)[:, axis:].max(axis=0).min() > 1e-4  # mm: x moves both axes
    assert np.abs(moved[:, axis] - change).max() < 0.03 * size, "mm"


def test_the_unknown_part_is_the_mean_of_random_responses() -> None:
    """Their gain at each frequency is as unknown says, and they last as long as the response."""
    G = mode(40.0, unknown=(0.0, 0.4, 0.8, 0.3))
    doubts = Doubts.from_plant(Plant(G, mode(30.0), None, 0.0))
    assert doubts is not None
    command = np.pad(strokes(), ((0, 500), (0, 0)), mode="edge")
    _, unknown = along(doubts, command)
    squared = np.square(G.deviation)
    time = float(squared @ np.arange(len(squared)) / squared.sum())
    envelope = np.exp(-np.arange(400) / (2.0 * time))
    envelope /= np.sqrt(np.square(envelope).sum())
    rng, count, squares = np.random.default_rng(0), 200, 0.0
    still = Plant(ImpulseResponse(np.zeros(1), 0), mode(30.0), None, 0.0)
    for _ in range(count):
        q = np.convolve(G.unknown, envelope * rng.normal(size=len(envelope)))
        shaken = replace(still, Gxx=ImpulseResponse(q, 0))
        off = nozzle(shaken, ORIGIN, command)[:, X] - command[:, X]
        squares += float(np.square(off).mean()) / count
    assert unknown[:, X].mean() == pytest.approx(squares, rel=0.15)  # mm²
    assert not unknown[:, Y].any()


def test_the_quantiles_are_those_of_normal_drifts() -> None:
    """Of one axis alone, they are quantiles of |z|; of nothing at all, the error itself."""
    d = np.array([[2.0, 0.0]])
    known = error_range(products(np.zeros(1), d, np.zeros(1)).sum(axis=0), 0.0)
    assert known.median == pytest.approx(2.0 * 0.674, rel=0.1)  # mm
    assert known.high == pytest.approx(2.0 * 1.96, rel=0.1)
    assert known.low < 0.3
    sums = products(np.array([0.3, 0.4]), np.zeros((2, 2)), np.zeros(2)).sum(axis=0)
    known = error_range(sums, 0.125)
    assert {known.low, known.median, known.high} == {0.125**0.5}


def as_measured(drift: float) -> Printer:
    """Return a printer of responses that drift; its motors follow anything."""
    printer = load("example-corexy")
    plant = Plant(mode(47.0, drift), mode(39.0, drift), None, 0.0)
    compensation = replace(printer.compensation, effort=(10.0, 10.0))
    return replace(printer, plant=plant, compensation=compensation)


def predicted(printer: Printer) -> tuple[ContourErrors, Samples]:
    """Return the error of a rectangle, and the commands that make it."""
    commands = WholeFile(rectangle(printer), printer, Options("fbs", ("fbs",), clamp=True))
    chunks = list(commands.samples())
    (chunk,) = [each for each in chunks if len(each) > 1000]
    return commands.report.contour["fbs"], chunk


@pytest.mark.parametrize("drift", [0.01, 0.03])
def test_nine_of_ten_printers_are_in_the_range(drift: float) -> None:
    printer = as_measured(drift)
    contour, chunk = predicted(printer)
    known, inside, count = contour.range, 0, 40
    assert known is not None
    rng = np.random.default_rng(1)
    for _ in range(count):
        x, y = 1.0 + drift * rng.normal(size=2)
        assert isinstance(printer.plant.Gxx, ImpulseResponse)
        assert isinstance(printer.plant.Gyy, ImpulseResponse)
        other = replace(
            printer.plant, Gxx=printer.plant.Gxx.stretched(x), Gyy=printer.plant.Gyy.stretched(y)
        )
        errors = ContourErrors()
        for judgement in judge([chunk], other, 4):
            errors.add(judgement.contour["fbs"], judgement.extruding)
        inside += known.low <= errors.rms <= known.high
    assert 0.8 * count <= inside < count, f"printers in {known} mm, of {count}"


def test_a_model_that_counts_as_exact_has_no_range() -> None:
    printer = as_measured(0.0)
    assert Doubts.from_plant(printer.plant) is None
    contour, _ = predicted(printer)
    assert contour.range is None
    assert set(contour.micrometres()) == {"rms", "p95", "peak", "all"}
    assert contour.shown.doubts.shape == (SUMS,)
