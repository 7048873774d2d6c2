"""Solvers of an axis whose response changes along x, one for each node of the response.

A window is solved for the response at its place, with the exact past. That the response changes
within the window is corrected in rounds: what the previous command misses, by the full sum over
the nodes, is added to the target.
"""

from __future__ import annotations

from hframe_post.arrays import Array
from hframe_post.errors import ArgumentError, HframeError
from hframe_post.model.filters import FiniteFilter
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.lpfbs import Lpfbs, Window


class SolversAlongX:
    """Solvers by place, each made when it is first needed. Raises ArgumentError as ``Lpfbs`` does.

    memory: samples of the command before a window that its response depends on.
    """

    def __init__(self, G: ImpulseResponse, window: Window) -> None:
        self.G, self.window, self.lead = G, window, G.ahead
        self.memory = max(self._memory(node) for _, node in G.nodes)
        doubts = [self._memory(doubt) for _, node in G.nodes for doubt in node.doubts]
        longest = max([self.memory, *doubts]) + window.L * (window.degree + 1)
        self._reach = -(-longest // window.L)
        self._made: dict[int, tuple[Lpfbs, FiniteFilter]] = {}
        for k in (0, len(G.nodes) - 1, G.node(G.x)):
            self.rest = self._at(k)[0].rest

    def window_command(self, target: Array, u: Array, x: float, s: Array) -> tuple[Array, Array]:
        """Return the command (stride,) of a window, and the next s.

        target (L_C,): less what a command u does, by the whole plant, ``lead`` samples late. u
        (memory + L_C,): that command. x: mm, where the nozzle is meanwhile. Raises HframeError if
        the window does not suit the response there.
        """
        try:
            solver, response = self._at(self.G.node(x))
        except ArgumentError as error:
            raise HframeError(f"at x = {x:.0f} mm, {error}") from None
        response.state = u[self.memory - response.memory : self.memory]
        return solver.run(target + response.run(u[self.memory :]), s)

    def _memory(self, G: ImpulseResponse) -> int:
        return FiniteFilter(G, max(G.ahead, self.lead)).memory

    def _at(self, k: int) -> tuple[Lpfbs, FiniteFilter]:
        """Return the solver and the response of a node."""
        if k not in self._made:
            node = self.G.nodes[k][1]
            solver = Lpfbs(node, self.window, self.lead, self._reach)
            self._made[k] = solver, FiniteFilter(node, self.lead)
        return self._made[k]
