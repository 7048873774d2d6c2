"""The trade-off of window and weight, and which of them is recommended."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.model.lpfbs import Window
from hframe_post.printer import profile
from hframe_post.printer.settings import Motors, Printer
from hframe_post.studies.tuning import ROUGHLY, Trial, recommended, rectangle, tried

EFFORT = (1.0, 10.0, 100.0, 1000.0)
SLACK = 1.03  # of numbers that should be in order


@pytest.fixture(scope="module")
def profiled() -> Printer:
    return profile.load("paper")


@pytest.fixture(scope="module")
def trials(profiled: Printer) -> list[Trial]:
    drawn = profiled.plant.drawn(0.05, 2, 0)
    grid = [windows(L, effort) for L in (5, 20) for effort in EFFORT]
    return [tried(rectangle(profiled), profiled, each, drawn) for each in grid]


def windows(L: int, effort: float) -> tuple[Window, Window]:
    n_C = 440 // L
    return Window(L, n_C, n_C // 2, effort), Window(L, n_C, n_C // 2, 188.0 / 96.0 * effort)


def test_more_effort_is_more_error_and_less_acceleration(trials: list[Trial]) -> None:
    for L in (5, 20):
        usable = [t for t in trials if t.windows[0].L == L and not t.refused]
        assert len(usable) >= 3
        for harder, gentler in pairwise(usable):
            assert gentler.contour.rms * SLACK >= harder.contour.rms
            assert gentler.acceleration <= SLACK * harder.acceleration
        hardest, gentlest = usable[0], usable[-1]
        assert gentlest.contour.rms > 1.1 * hardest.contour.rms
        assert gentlest.acceleration < 0.9 * hardest.acceleration


def test_a_window_that_diverges_is_refused_and_the_others_are_tried(profiled: Printer) -> None:
    bad = Window(20, 11, 5, 0.0)
    good = profiled.compensation.windows
    grid = ((bad, bad), good)
    refused, able = (tried(rectangle(profiled), profiled, each, []) for each in grid)
    assert "spectral radius" in refused.refused
    assert not refused.within(profiled.motors)
    assert not able.refused
    assert able.contour.all.count > 0
    assert recommended([refused, able], profiled.motors) is able


WINDOW = Window(5, 88, 44, 1.0)
ERROR = st.sampled_from([1.0, 1.05, 1.09, 1.2, 3.0])  # some as good as the best
FIGURES = st.tuples(ERROR, st.floats(1.0, 100.0), st.floats(1.0, 100.0))


@given(st.lists(st.tuples(FIGURES, st.booleans()), max_size=8))
def test_the_gentlest_of_the_good(printed: list[tuple[tuple[float, float, float], bool]]) -> None:
    trials, motors = [], Motors(50.0, 50.0)
    for (error, velocity, acceleration), refused in printed:
        trial = Trial((WINDOW, WINDOW), "diverges" if refused else "")
        trial.contour.add(np.array([error]), np.array([True]))
        trial.velocity, trial.acceleration = velocity, acceleration
        trials.append(trial)
    best = recommended(trials, motors)
    able = [t for t in trials if not t.refused and max(t.velocity, t.acceleration) <= 50.0]
    if best is None:
        assert not able
    else:
        least = min(t.contour.rms for t in able)
        assert any(best is trial for trial in able)
        assert best.contour.rms <= ROUGHLY * least
        gentler = [t for t in able if t.acceleration < best.acceleration]
        assert all(t.contour.rms > ROUGHLY * least for t in gentler)


def test_a_little_on_wrong_models_is_not_worth_several_times_the_error_of_the_model() -> None:
    def trial(model: float, wrong: float, acceleration: float) -> Trial:
        made = Trial((WINDOW, WINDOW), acceleration=acceleration)
        made.drawn = [type(made.contour)()]
        made.contour.add(np.array([model]), np.array([True]))
        made.drawn[0].add(np.array([wrong]), np.array([True]))
        return made

    hard, gentle = trial(2.0, 10.5, 40.0), trial(12.0, 10.0, 10.0)
    assert recommended([hard, gentle], Motors(50.0, 50.0)) is hard
    alike = trial(2.1, 11.0, 20.0)
    assert recommended([hard, alike, gentle], Motors(50.0, 50.0)) is alike
