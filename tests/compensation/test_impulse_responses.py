"""Compensation and prediction with impulse responses: as with transfer functions, and two-sided."""

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.errors import ArgumentError
from hframe_post.model.impulse_response import FiniteFilter, ImpulseResponse
from hframe_post.model.lpfbs import Lpfbs, Window
from hframe_post.model.plant import Bed, Plant, nozzle
from hframe_post.model.strategies import STRATEGIES, Compensator
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.paths import ORIGIN, strokes
from tests.plants import axis_mode, coupling_mode, deviation_of_mode, resonant


def measured() -> Plant:
    """Return an H-bot that racks; y and racking lag."""
    theta = coupling_mode(38.0, 0.08, 4e-4)
    theta = replace(theta, zeros=theta.zeros[:1], gain=0.1 * theta.gain)  # by velocity, too
    response = ImpulseResponse.from_transfer_function
    x, y = axis_mode(43.0, 0.08), resonant(31.0, 0.09)
    return Plant(response(x, 1.0), response(y, 1.0), response(theta, 0.0), 140.0)


def two_sided(hz: float, damping: float, m: int = 300, lead: int = 32) -> ImpulseResponse:
    """Return a mode whose first part is smeared over time before the command, as if measured."""
    late = np.convolve(deviation_of_mode(hz, damping, m - lead), np.hanning(2 * lead + 1), "full")
    return ImpulseResponse(late[:m] / lead * np.linspace(1.0, 0.0, m), lead)


def early() -> Plant:
    """Return a plant of responses with different leads, and transfer functions among them."""
    plant = measured()
    G = two_sided(47.0, 0.1)
    theta = ImpulseResponse(1e-4 * G.deviation, G.lead, 0.0)
    Gxx, Gyy = two_sided(43.0, 0.06), two_sided(31.0, 0.07, lead=17)
    return replace(plant, Gxx=Gxx, Gyy=Gyy, Gxtheta=theta)


@pytest.fixture(scope="module")
def hbot() -> Printer:
    return load("paper")


# ---------------------------------------------------------------------- filters


def by_definition(G: ImpulseResponse, u: Array) -> Array:
    """Return the response to an input that stands still before and after it."""
    n, m = len(u), len(G.deviation)
    c = np.pad(u, m + 2, mode="edge")
    a = np.pad(np.diff(c, n=2), 1)  # a[k] around c[k]
    after = np.convolve(a, G.deviation)[G.lead :][: len(c)]
    late = G.lag * np.diff(c, prepend=c[0])
    return np.asarray((G.rest * c - late + after)[m + 2 :][:n])


@pytest.mark.parametrize(("late", "lag"), [(33, 0.0), (40, 0.0), (33, 1.7), (300, -2.4)])
@pytest.mark.parametrize("rest", [1.0, 0.0])
def test_a_filter_is_the_definition_wherever_cut(rest: float, late: int, lag: float) -> None:
    rng = np.random.default_rng(2)
    G = ImpulseResponse(rng.normal(size=150), 32, rest, lag)
    u = np.cumsum(np.pad(rng.normal(size=900), (100, 200)))
    cuts = np.sort(rng.integers(0, len(u), 30))

    def run(pieces: list[Array]) -> Array:
        f = FiniteFilter(G, late)
        return np.concatenate([f.run(piece) for piece in pieces])

    whole = run([u])
    off = whole[late:] - by_definition(G, u)[: len(u) - late]
    assert np.abs(off).max() < 1e-11  # mm
    assert np.array_equal(run(np.split(u, cuts)), whole)
    assert np.array_equal(run(np.split(u, np.arange(1, len(u)))), whole)


# ---------------------------------------------------------------------- one axis


def test_a_response_that_cannot_be_inverted_is_refused() -> None:
    noise = ImpulseResponse(1e6 * np.random.default_rng(0).normal(size=400), 200)
    with pytest.raises(ArgumentError, match=r"rank deficient|diverges"):
        Lpfbs(noise, Window(5, 12, 11, 0.0))


# ---------------------------------------------------------------------- what is not known

WINDOW = Window(5, 88, 44, 30.0)
EASY = replace(WINDOW, effort=1e-3)  # enough to make it regular


def unsure(drift: float = 0.0, unknown: float = 0.0) -> ImpulseResponse:
    """Return a response whose frequencies drift, and of which a part near 60 Hz is not known."""
    w = unknown * deviation_of_mode(60.0, 0.1, 200) if unknown else np.zeros(0)
    return ImpulseResponse(deviation_of_mode(43.0, 0.05, 600), 0, drift=drift, unknown=w)


def infill() -> Array:
    """Return short strokes to and fro with 5000 mm/s², from zero and back, (n,) mm."""
    to_and_fro = ((h, sign) for h in (6, 8, 11, 15, 23) for sign in (1.0, -1.0, 1.0, -1.0))
    rate = [np.repeat([sign, -sign], h) for h, sign in to_and_fro]
    acceleration = 5e-3 * np.concatenate(rate)  # mm/ms²
    return np.pad(np.cumsum(np.cumsum(acceleration)), 400, mode="edge")


def squared_error(response: ImpulseResponse, command: Array, target: Array | float) -> float:
    off = FiniteFilter(response, 40).run(np.pad(command, (0, 40), mode="edge"))[40:] - target
    return float(np.square(1e3 * off).mean())  # µm²


def test_a_doubt_of_all_frequencies_is_what_stretching_changes() -> None:
    G = replace(two_sided(43.0, 0.1), lag=2.0, drift=0.01)
    (doubt,) = G.doubts
    omega = np.linspace(0.01, 0.6, 200)  # to 95 Hz
    longer, shorter = (G.stretched(factor).response(omega) for factor in (1.01, 1.0 / 1.01))
    changed, size = (longer - shorter) / 2.0, np.abs(G.response(omega) - 1.0).max()
    assert np.abs(doubt.response(omega) - changed).max() < 0.01 * size
    assert (doubt.drift, doubt.dc_gain, len(doubt.doubts)) == (0.0, 0.0, 0)


@pytest.mark.parametrize("exact", [unsure(drift=0.03), unsure(unknown=0.2), unsure(0.02, 0.1)])
def test_commands_have_the_least_expected_error(exact: ImpulseResponse) -> None:
    """Among those of a solver that doubts less or more."""
    path = infill()

    def expected(assumed: float) -> float:
        drift, unknown = assumed * exact.drift, assumed * exact.unknown
        command = Lpfbs(replace(exact, drift=drift, unknown=unknown), EASY).command(path)
        errors = [squared_error(doubt, command, 0.0) for doubt in exact.doubts]
        return squared_error(replace(exact, drift=0.0), command, path) + sum(errors)

    least = expected(1.0)
    for assumed in (0.0, 0.5, 2.0):
        assert least < 0.999 * expected(assumed), f"µm², doubts {assumed} times as great"


# ---------------------------------------------------------------------- whole plants


@pytest.mark.parametrize("strategy", ["fbs", "racking"])
def test_a_two_sided_plant_is_inverted(strategy: str) -> None:
    plant = early() if strategy == "racking" else early().decoupled()
    path = np.pad(strokes(), ((300, 300), (0, 0)), mode="edge")
    state = STRATEGIES[strategy].begin(Compensator(plant, (WINDOW, WINDOW)), ORIGIN)
    command = np.concatenate([state.feed(path), state.finish()])
    off, without = (nozzle(plant, ORIGIN, u) - path for u in (command, path))
    assert np.sqrt(np.square(without).mean()) > 0.01  # mm
    assert np.sqrt(np.square(off).mean()) < 1e-3  # mm


# ---------------------------------------------------------------------- other printers


def test_a_bed_gets_heavier_with_its_lead(hbot: Printer) -> None:
    bed = Bed(0.5, 1e-4)
    plant = replace(early(), bed=bed)
    compensator = Compensator(plant, (WINDOW, WINDOW))
    loaded = compensator.at(2000.0)
    assert loaded.plant.Gyy.ahead > plant.Gyy.ahead
    state = STRATEGIES["racking"].begin(loaded, ORIGIN)
    path = np.pad(strokes(), ((300, 300), (0, 0)), mode="edge")
    command = np.concatenate([state.feed(path), state.finish()])
    off = nozzle(loaded.plant, ORIGIN, command) - path
    assert np.sqrt(np.square(off).mean()) < 1e-3  # mm
