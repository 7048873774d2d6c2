"""Printers whose modes move x and y together: as measured, and as a simulation of their motion."""

from dataclasses import dataclass

import numpy as np
from scipy import signal

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.estimation.frequency_response import FrequencyResponse
from hframe_post.model.plant import Coupling, Plant
from hframe_post.model.transfer_function import TransferFunction
from tests.plants import as_response
from tests.simulator import RATE, STEPS

BAND = (4.0, 100.0)
HZ = np.arange(BAND[0], BAND[1], 0.125)
AVERAGES = 12.0
X_C = 120.0  # mm
Pair = tuple[FrequencyResponse, FrequencyResponse]


@dataclass(frozen=True)
class Coupled:
    """A printer of two modes at right angles, turned by ``angle`` (rad) against x and y.

    own: share of a mode at 75 Hz that only a command in x excites, and only in y. racking: rad
    per mm/s² about x_c. turned: of the sensor, rad.
    """

    hz: tuple[float, float] = (45.0, 32.0)
    zeta: tuple[float, float] = (0.06, 0.08)
    angle: float = 0.2
    own: float = 0.0
    racking: float = 0.0
    turned: float = 0.0
    delay: float = 1.5e-3

    def response(self, hz: Array, x: float = X_C) -> Complex:
        """Return the matrix (k, 2, 2) of the nozzle at x (mm)."""
        s = np.asarray(2j * np.pi * hz)
        c, d = np.cos(self.angle), np.sin(self.angle)
        shapes = np.array([[c, d], [-d, c]])
        modes = [_mode(s, *each) for each in zip(self.hz, self.zeta, strict=True)]
        G = np.einsum("mk,mi,mj->kij", np.array(modes), shapes, shapes)
        own = self.own * np.subtract(_mode(s, 75.0, 0.08), _mode(s, 45.0, 0.06))
        theta = self.racking * s**2 * _mode(s, 60.0, 0.1) * _mode(s, self.hz[0], self.zeta[0])
        G[:, 1, 0] += own + (x - X_C) * theta
        return np.asarray(G * np.exp(-s * self.delay)[:, None, None])

    def measured(
        self, direction: tuple[float, float], seed: int, x: float = X_C, noise: float = 0.003
    ) -> Pair:
        """Return the responses of the sensor's x and y to a run along the direction.

        noise: of a response, as a share of the command.
        """
        d = np.divide(direction, np.hypot(*direction))
        H = (self._sensed(HZ, x) @ d).T
        rng = np.random.default_rng(seed)
        H = H + noise * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / 2**0.5
        coherence = np.abs(H) ** 2 / (np.abs(H) ** 2 + AVERAGES * noise**2)
        first, second = (
            FrequencyResponse(HZ, *each, np.ones(len(HZ)), AVERAGES)
            for each in zip(H, coherence, strict=True)
        )
        return first, second

    def _sensed(self, hz: Array, x: float) -> Complex:
        c, s = np.cos(self.turned), np.sin(self.turned)
        return np.asarray(np.array([[c, s], [-s, c]]) @ self.response(hz, x))


def _mode(s: Complex, hz: float, zeta: float) -> Complex:
    w = 2.0 * np.pi * hz
    return np.asarray(w * w / (s * s + 2.0 * zeta * w * s + w * w))


@dataclass(frozen=True)
class SharedMode:
    """A resonance: what it takes of the commands in x and y, and how it moves the nozzle."""

    hz: float
    damping: float
    command: tuple[float, float]
    moves: tuple[float, float]

    def discrete(self, rate: float) -> tuple[Array, Array, Array]:
        """Return numerators of position and acceleration, (2, 3), and the denominator."""
        w = 2.0 * np.pi * self.hz
        A = np.array([[0.0, 1.0], [-w * w, -2.0 * self.damping * w]])
        C, D = np.array([[1.0, 0.0], A[1]]), np.array([[0.0], [w * w]])
        held = signal.cont2discrete((A, np.array([[0.0], [w * w]]), C, D), 1.0 / rate, "foh")
        num, den = signal.ss2tf(*held[:4])
        return num[0], num[1], den


@dataclass(frozen=True)
class CoupledMachine:
    """A CoreXY of modes that may move both axes; exact for a command of straight lines of 1 ms."""

    modes: tuple[SharedMode, ...]
    kinematics: str = "corexy"

    def exact(self) -> Plant:
        """Return the plant, exactly discretised for straight lines of 1 ms."""
        G = [[self._discrete(answer, command) for command in (0, 1)] for answer in (0, 1)]
        cross = [
            Coupling(answer, 1 - answer, as_response(response, 0.0))
            for answer in (0, 1)
            if (response := G[answer][1 - answer]) is not None
        ]
        assert G[0][0] is not None
        assert G[1][1] is not None
        return Plant(as_response(G[0][0]), as_response(G[1][1]), None, X_C, tuple(cross))

    def _discrete(self, answer: int, command: int) -> TransferFunction | None:
        taken = [
            (mode.discrete(1.0 / TS), share)
            for mode in self.modes
            if (share := mode.moves[answer] * mode.command[command])
        ]
        if not taken:
            return None
        num: Array = np.zeros(1)
        den: Array = np.ones(1)
        for (position, _, own), share in taken:
            num = np.asarray(np.polyadd(np.polymul(num, own), share * np.polymul(den, position)))
            den = np.asarray(np.polymul(den, own))
        num = np.asarray(np.trim_zeros(num, "f"))
        zeros = np.roots(num).astype(complex)
        zeros[np.argsort(np.abs(zeros - 1.0))[: int(answer != command)]] = 1.0
        return TransferFunction(zeros, np.roots(den).astype(complex), float(num[0]))

    def played(self, command: Array, keep: int = STEPS, step: float = 0.0) -> Array:
        """Return x, y, their accelerations, and twice 0, as ``Machine.played`` does."""
        assert keep in (1, STEPS)
        assert not step
        rate = RATE / keep
        at = np.arange(1, (len(command) - 1) * STEPS // keep + 1) / rate
        known = np.arange(len(command)) * TS
        start = command[0]
        u = np.column_stack([np.interp(at, known, one) for one in (command - start).T])
        out = np.zeros((len(u), 6))
        for mode in self.modes:
            *moved, den = mode.discrete(rate)
            taken = np.concatenate([[0.0], u @ mode.command])  # from the start on, at rest
            for k, numerator in enumerate(moved):  # position, acceleration
                q = signal.lfilter(numerator, den, taken)[1:]
                out[:, 2 * k : 2 * k + 2] += np.outer(q, mode.moves)
        out[:, :2] += start
        return out
