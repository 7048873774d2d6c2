"""Moves of one axis as Marlin plays them: whole steps and step rates, and its planner's ramps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.firmware.code import plain
from hframe_post.firmware.marlin.code import TRAPEZOIDS, MarlinCode
from hframe_post.firmware.written_moves import WrittenMoves
from hframe_post.model.kinematics import Kinematics
from hframe_post.native.whole_steps import Blocks, most_steps, motor_steps

# With CLASSIC_JERK, planners up to 2.1 compare the speed of a block with that of the one before,
# although the faster one need not begin at its own. So M205 allows every speed, and the axis turns
# back where it is slow
SLOW = 4.0  # mm/s


@dataclass(frozen=True, slots=True)
class MarlinMoves(WrittenMoves):
    """Moves as Marlin plays them."""

    code: MarlinCode
    kinematics: Kinematics

    @property
    def step(self) -> float:
        return self.code.steps.belt

    @property
    def least(self) -> int:
        return self.code.table.min_steps_per_segment

    @property
    def reversal(self) -> float:
        return SLOW if self.code.table.classic_jerk else 0.0

    @property
    def begin(self) -> list[str]:
        return ["M400", "M593 F0", self.code.motion_mode, TRAPEZOIDS]

    @property
    def after_cancel(self) -> str:
        return "send M501: it brings back the settings that are saved in the printer."

    def limits(self, fastest: float, acceleration: float) -> list[str]:
        v, a = plain(fastest, 0), plain(acceleration, 0)
        corners = f"X{v} Y{v} E1" if self.code.table.classic_jerk else "J0.3"
        return [
            "M400", f"M201 X{a} Y{a}", f"M203 X{v} Y{v}", f"M204 P{a} T{a}",
            f"M205 B0 S0 T0 {corners}",
        ]  # fmt: skip

    def ahead(self, z: float) -> list[str]:
        return self.code.filling_lines(z)

    def speed(self, v: float) -> float:
        """Return a feed rate: Marlin rounds steps a second up, or where moves meet to the nearest.

        The development branch does the latter.
        """
        return (round(v / self.step) - 0.4) * self.step

    def motion(self, cells: Integers, v: Array, turns: Array, acceleration: float) -> Array:
        n = most_steps(motor_steps(cells, self.kinematics.matrix)).astype(np.float64)
        d, at = self._along(cells)
        blocks = Blocks(n, d, np.floor(acceleration * n / d))
        return np.interp(self.code.planner.travelled(blocks, turns, v), *at)
