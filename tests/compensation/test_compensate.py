"""Commands through the plant trace the path, with couplings of the axes, too."""

from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array
from hframe_post.compensation.compensate import SETTLED, compensate, settling_samples
from hframe_post.model.strategies import Compensator
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Travel
from hframe_post.stream.chunks import join
from hframe_post.stream.types import Samples
from tests.paths import stroke


def block(x: Array, y: Array, first: int = 0) -> Samples:
    xyze = np.column_stack([x, y, np.zeros((len(x), 2))])
    return Samples(first, xyze, np.zeros(len(x), dtype=np.int64))


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
