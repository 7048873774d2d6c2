"""Commands in whole motor steps, on the ticks of the stepping clock."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.settings import Steps
from hframe_post.stream.chunks import stretches, with_neighbours
from hframe_post.stream.types import Samples, frozen


def quantise(chunks: Iterable[Samples], kinematics: Kinematics, steps: Steps) -> Iterator[Samples]:
    """Yield the chunks with their commands in whole steps."""
    for stretch in stretches(chunks):
        for chunk, wide, where in with_neighbours(stretch, 1, 1):
            commands = {
                name: frozen(stepped(command, kinematics, steps)[where])
                for name, command in wide.commands.items()
            }
            yield replace(chunk, commands=commands)


def stepped(command: Array, kinematics: Kinematics, steps: Steps) -> Array:
    """Return the command (n, 2) with both belts in whole steps, (n, 2).

    A sample is the mean over the ticks of the millisecond around it, since carriage and belts do
    not follow a single step at 40 kHz. The command is interpolated at the ticks.
    """
    ticks = max(round(steps.clock_hz * TS), 1)
    belts = kinematics.belts(*command.T).T / steps.belt
    before, after = (
        np.diff(belts, axis=0, prepend=belts[:1]),
        np.diff(belts, axis=0, append=belts[-1:]),
    )
    mean = np.zeros_like(belts)
    for k in range(ticks):
        at = (k + 0.5) / ticks - 0.5
        mean += np.rint(belts + at * (before if at < 0.0 else after))
    return np.asarray(np.linalg.solve(kinematics.matrix, mean.T * (steps.belt / ticks)).T)
