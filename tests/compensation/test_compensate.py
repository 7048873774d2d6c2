"""Commands through the plant trace the path, with couplings of the axes, too."""

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import Array, X, Y
from hframe_post.compensation.compensate import SETTLED, compensate, settling_samples
from hframe_post.compensation.guard import check_model
from hframe_post.errors import PrinterError
from hframe_post.model.lpfbs import Window
from hframe_post.model.nozzle import Response
from hframe_post.model.plant import Coupling, Plant
from hframe_post.model.rounds import order, rounds_needed
from hframe_post.model.strategies import STRATEGIES, Compensator
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Travel
from hframe_post.stream.chunks import join
from hframe_post.stream.types import Samples
from tests.coupled import coupled_plant
from tests.paths import ORIGIN, stroke, strokes


def block(x: Array, y: Array, first: int = 0) -> Samples:
    xyze = np.column_stack([x, y, np.zeros((len(x), 2))])
    return Samples(first, xyze, np.zeros(len(x), dtype=np.int64))


def traced(compensator: Compensator, samples: Samples, strategy: str) -> Array:
    done = join(list(compensate([samples], compensator, (strategy,))))
    response = Response(compensator.plant, samples.xyze[0, :2])
    return response.run(done.commands[strategy]) - samples.xyze[:, :2]


@pytest.mark.paper
def test_eq_12_and_19_the_nozzle_follows_where_the_lever_is_long(compensator: Compensator) -> None:
    x = 220.0 + stroke(40, 150, 500)
    error = traced(compensator, block(x, np.full(len(x), 50.0)), "racking")
    assert np.sqrt(np.square(error).mean(axis=0)).max() < 0.02


def test_settling_covers_the_fastest_stop(compensator: Compensator) -> None:
    limits = replace(load("paper").limits, velocity=150.0, acceleration=5000.0)
    reached = Travel((140.0, 280.0), (0.0, 280.0))  # x_c is 140: a lever arm of 140 mm
    r = settling_samples(compensator, limits, reached)
    x = stroke(75, 150, 1000)
    samples = block(280.0 - x.max() + x, x)
    done = join(list(compensate([samples], compensator, ("racking",))))
    off = np.abs(done.commands["racking"] - samples.xyze[:, :2]).max(axis=1)
    assert (off[-1000 + r + 5 :] < 1.2 * SETTLED).all(), "mm"
    assert (off[: 1000 - r - 5] < 1.2 * SETTLED).all(), "mm"
    assert off[-1000 + r - 20] > 0.8 * SETTLED, "mm"


WINDOW = Window(5, 88, 44, 30.0)


def commanded(plant: Plant, strategy: str = "racking", cuts: tuple[int, ...] = ()) -> Array:
    state = STRATEGIES[strategy].begin(Compensator(plant, (WINDOW, WINDOW)), ORIGIN)
    return np.concatenate([*map(state.feed, np.split(strokes(), cuts)), state.finish()])


def left(plant: Plant, command: Array) -> float:
    """Return the RMS deviation from the path, mm."""
    off = Response(plant, ORIGIN).run(command) - strokes()
    return float(np.sqrt(np.square(off).mean()))


def test_racking_is_one_coupling_of_many() -> None:
    """The same bits, in prediction and compensation, whether it has its own name or not."""
    paper = load("paper").plant
    assert paper.Gxtheta is not None
    unnamed = replace(
        paper, Gxtheta=None, cross=(Coupling(Y, X, paper.Gxtheta, X, paper.x_c),)
    )  # fmt: skip
    command = commanded(paper)
    np.testing.assert_array_equal(commanded(unnamed), command)
    one, other = (Response(plant, ORIGIN).run(command) for plant in (paper, unnamed))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("along", [X, Y])
def test_a_lever_arm_grows_with_the_distance_from_its_centre(along: int) -> None:
    whole = coupled_plant(2)
    G = whole.cross[1].G
    plant = replace(whole, cross=(Coupling(Y, X, G, along, 50.0),))
    wave = np.zeros((300, 2))
    wave[:, X] = 1e-6 * np.sin(np.arange(300) / 5.0)  # so small that the lever stays

    def added(place: float) -> Array:
        origin = np.zeros(2)
        origin[along] = place
        response = Response(plant, origin)
        without = Response(plant.decoupled(), origin)
        return response.run(origin + wave)[:, Y] - without.run(origin + wave)[:, Y]

    np.testing.assert_allclose(added(50.0), 0.0, atol=1e-10)
    np.testing.assert_allclose(added(250.0), -2.0 * added(-50.0), atol=1e-9)


@pytest.mark.parametrize("answer", [X, Y])
def test_a_coupling_one_way_leaves_no_more_than_the_axes_alone(answer: int) -> None:
    whole = coupled_plant(2)
    plant = replace(whole, cross=tuple(c for c in whole.cross[::2] if c.answer == answer))
    assert order(plant.couplings, 2) == (1 - answer, answer)
    alone = left(plant.decoupled(), commanded(plant.decoupled()))
    assert left(plant, commanded(plant, "fbs")) > 3.0 * alone
    assert left(plant, commanded(plant)) < 1.1 * alone


@pytest.mark.parametrize("seed", [0, 3])
def test_coupled_compensation_of_random_printers(seed: int) -> None:
    plant = coupled_plant(seed, most=0.2, racks=bool(seed % 2))
    decoupled = left(plant, commanded(replace(plant, cross=())))
    alone = left(plant.decoupled(), commanded(plant.decoupled()))
    assert left(plant, commanded(plant)) < alone + 0.3 * (decoupled - alone)


def test_stronger_couplings_take_more_rounds_and_no_command_cancels_too_strong_ones() -> None:
    windows, paper = (WINDOW, WINDOW), load("paper")
    weak, strong = (coupled_plant(seed) for seed in (1, 0))
    assert rounds_needed(weak, windows) == 2
    assert rounds_needed(strong, windows) == 4
    check_model(strong, windows, paper.travel, paper.limits)
    stronger = [
        replace(c, G=replace(c.G, deviation=3.0 * c.G.deviation, lag=3.0 * c.G.lag))
        for c in strong.cross
    ]
    too_strong = replace(strong, cross=tuple(stronger))
    with pytest.raises(PrinterError, match="couplings of this model are so strong"):
        check_model(too_strong, windows, paper.travel, paper.limits)


def test_equal_bits_however_the_stream_is_cut() -> None:
    plant = coupled_plant(4, racks=True)
    whole = commanded(plant)
    for cuts in ((1, 2, 2, 700), tuple(range(7, 2000, 7))):
        np.testing.assert_array_equal(commanded(plant, cuts=cuts), whole)
