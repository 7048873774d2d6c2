"""Commands in whole steps: never more than half a step off."""

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import TS, Array
from hframe_post.model.kinematics import Kinematics
from hframe_post.prediction.predict import quantise, stepped
from hframe_post.printer.settings import Steps
from hframe_post.stream.types import Dwell, Handling, ModalState, Passthrough, Samples

STEPS = Steps(belt=0.0206, z=0.0025, e=0.0024, clock_hz=40_000.0)
STATE = ModalState(True, True, 0.0, 60.0, (0.0, 0.0, 0.0))
KINEMATICS = [
    Kinematics("hbot"),
    Kinematics("corexy", signs=(1.0, -1.0)),
    Kinematics("cartesian"),
    Kinematics("cartesian", swap=True, signs=(-1.0, 1.0)),
]
TYPES = pytest.mark.parametrize("kinematics", KINEMATICS, ids=lambda k: f"{k.type}-{k.swap}")


def curve(n: int, seed: int = 0) -> Array:
    """Return a smooth command of up to some hundred mm/s, (n, 2), with rest at both ends."""
    rng = np.random.default_rng(seed)
    speed = np.cumsum(rng.normal(size=(n, 2)), axis=0) * 5.0
    speed[: n // 5] = speed[-n // 5 :] = 0.0
    return np.asarray(100.0 + np.cumsum(speed, axis=0) * TS)


def exact_mean(belt: Array, ticks: int) -> tuple[Array, Array]:
    """Return a belt's mean position over the ticks of each millisecond, exact and in steps."""
    n = len(belt)
    at = np.arange(n)[:, None] + (np.arange(ticks) + 0.5) / ticks - 0.5
    position = np.interp(at, np.arange(n), belt)
    whole = np.floor(position / STEPS.belt + 0.5) * STEPS.belt
    return position.mean(axis=1), whole.mean(axis=1)


@TYPES
def test_each_belt_stays_within_half_a_step(kinematics: Kinematics) -> None:
    command = curve(500)
    asked, got = (kinematics.belts(*xy.T) for xy in (command, stepped(command, kinematics, STEPS)))
    for belt_asked, belt_got in zip(asked, got, strict=True):
        mean, in_steps = exact_mean(belt_asked, 40)
        np.testing.assert_allclose(belt_got, in_steps, atol=STEPS.belt / 39)  # a tie may fall over
        assert np.abs(belt_got - mean).max() <= STEPS.belt / 2 + 1e-9
        assert np.abs(belt_got - mean).max() > STEPS.belt / 4  # and it is stepped at all


def test_a_slow_clock_steps_once_a_sample() -> None:
    """One tick a millisecond or less: the nearest step of each sample."""
    command, kinematics = curve(200), Kinematics("cartesian")
    for clock_hz in (1000.0, 400.0):
        got = stepped(command, kinematics, replace(STEPS, clock_hz=clock_hz))
        np.testing.assert_allclose(got, np.rint(command / STEPS.belt) * STEPS.belt, atol=1e-9)


def blocks(sizes: list[int], yields: int | None = None) -> list[Samples]:
    """Return a command under two strategies, cut; one chunk may release the machine."""
    command, first, cut = curve(sum(sizes)), 0, []
    line = Passthrough(1, b"G28", Handling.RELEASE, STATE)
    for number, n in enumerate(sizes):
        xy = command[first : first + n]
        events = (Dwell(first + n, 0, line),) if number == yields else ()
        xyze, lines = np.pad(xy, ((0, 0), (0, 2))), np.zeros(n, np.int64)
        commands = {"racking": xy, "none": xy + 0.003}
        cut.append(Samples(first, xyze, lines, events, commands, number == yields))
        first += n
    return cut


def test_the_command_after_a_release_is_quantised_on_its_own() -> None:
    both = blocks([80, 120], yields=0)
    got = list(quantise(both, Kinematics(), STEPS))
    for one, block in zip(both, got, strict=True):
        expected = stepped(one.commands["none"], Kinematics(), STEPS)
        np.testing.assert_array_equal(block.commands["none"], expected)
