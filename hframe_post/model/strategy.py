"""What a strategy is: a name, and a course over each stretch of the path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from hframe_post.arrays import Array, X, Y
from hframe_post.model.lpfbs import Lpfbs, Window
from hframe_post.model.plant import Plant


class Compensator:
    """A plant with the certified solvers of its axes. Raises ValueError as ``Lpfbs`` does.

    windows: for x and y, of the same sizes.
    """

    def __init__(self, plant: Plant, windows: tuple[Window, Window]) -> None:
        self.plant = plant
        self.x, self.y = Lpfbs(plant.Gxx, windows[X]), Lpfbs(plant.Gyy, windows[Y])


class Course(Protocol):
    """One strategy at work on one stretch, which begins and ends at rest."""

    def feed(self, xy: Array) -> Array:
        """Takes the next of the path (n, 2), mm; gives what is finished of the command, (k, 2).

        All that was given so far is never longer than what was taken.
        """

    def finish(self) -> Array:
        """The rest of the command, (k, 2), at the end of the stretch: now all is given."""


def as_it_is(plant: Plant) -> Plant | None:
    """The plant that was identified."""
    return plant


@dataclass(frozen=True, slots=True)
class Strategy:
    """How a path becomes a command. label: as people read it; colour: in every figure.

    begin: the course of a stretch that starts from rest at ``origin`` (2,), mm. believes: the
    plant that its commands are made for; None where they are the path.
    """

    name: str
    label: str
    colour: str
    begin: Callable[[Compensator, Array], Course]
    believes: Callable[[Plant], Plant | None] = as_it_is
