"""Printers whose modes move x and y together, drawn, simulated and tested at several places.

A mode k has an input from both commands and moves the nozzle in both axes:

    q_k″ = ω_k²(b_k·u − q_k) − 2ζ_kω_k q_k′,   (x, y) = Σ (c_k + (x − x̄) s_k) q_k,   Σ c_k b_kᵀ = 1

The motion is that of each mode by itself, exact for a command of straight lines of 1 ms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.estimation.measured import Run
from hframe_post.identification.recordings.resonance_search import find
from hframe_post.model.plant import Coupling, Plant
from hframe_post.model.transfer_function import TransferFunction
from tests.plants import as_response
from tests.resonance_recordings import X, Y, drawn_sensor, klipper, recorded
from tests.simulator import RATE, STEPS, Chip

KINDS = ("constant", "lever", "shared", "oblique")
MIDDLE = 140.0  # mm of x
PLACES = (80.0, 140.0, 200.0)
Pair = tuple[float, float]


@dataclass(frozen=True)
class SharedMode:
    """A resonance: what it takes of the commands in x and y, and how it moves the nozzle.

    slope: change of ``moves`` per mm of x.
    """

    hz: float
    damping: float
    command: Pair
    moves: Pair
    slope: Pair = (0.0, 0.0)

    def at(self, x: float) -> Array:
        """Return how it moves the nozzle at x (mm), (2,)."""
        return np.add(self.moves, np.multiply(x - MIDDLE, self.slope))

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
    """A printer of modes that may move both axes. delay: s, the same for both commands."""

    modes: tuple[SharedMode, ...]
    delay: float = 0.0
    kinematics: str = "corexy"

    def response(self, hz: Array, x: float = MIDDLE) -> Complex:
        """Return the matrix (k, 2, 2) at x (mm), of response and command."""
        s = np.asarray(2j * np.pi * hz)
        total = np.zeros((len(hz), 2, 2), complex)
        for mode in self.modes:
            w = 2.0 * np.pi * mode.hz
            H = w * w / (s * s + 2.0 * mode.damping * w * s + w * w)
            total += H[:, None, None] * np.outer(mode.at(x), mode.command)
        return np.asarray(total * np.exp(-s * self.delay)[:, None, None])

    def exact(self) -> Plant:
        """Return the plant, exactly discretised for straight lines of 1 ms."""
        Gxx, Gyy = (
            self._discrete([mode.moves[k] * mode.command[k] for mode in self.modes], 0)
            for k in (0, 1)
        )
        shares = {
            (answer, command, along): [
                (mode.slope if along is not None else mode.moves)[answer] * mode.command[command]
                for mode in self.modes
            ]
            for answer, command in ((1, 0), (0, 1)) for along in (None, 0)
        }  # fmt: skip
        cross = [
            Coupling(answer, command, as_response(self._discrete(share, 1), 0.0), along, MIDDLE)
            for (answer, command, along), share in shares.items()
            if any(share)
        ]
        return Plant(as_response(Gxx), as_response(Gyy), None, MIDDLE, tuple(cross))

    def _discrete(self, shares: Sequence[float], zeros_at_rest: int) -> TransferFunction:
        assert not self.delay
        taken = [
            (mode.discrete(1.0 / TS), share)
            for mode, share in zip(self.modes, shares, strict=True)
            if share
        ]
        num: Array = np.zeros(1)
        den: Array = np.ones(1)
        for (position, _, own), share in taken:
            num = np.asarray(np.polyadd(np.polymul(num, own), share * np.polymul(den, position)))
            den = np.asarray(np.polymul(den, own))
        num = np.asarray(np.trim_zeros(num, "f"))
        zeros = np.roots(num).astype(complex)
        zeros[np.argsort(np.abs(zeros - 1.0))[:zeros_at_rest]] = 1.0
        return TransferFunction(zeros, np.roots(den).astype(complex), float(num[0]))

    def played(self, command: Array, keep: int = STEPS, step: float = 0.0) -> Array:
        """Return x, y, their accelerations, and twice 0, as ``Machine.played`` does."""
        assert keep in (1, STEPS)
        assert not step
        rate = RATE / keep
        at = np.arange(1, (len(command) - 1) * STEPS // keep + 1) / rate
        known = np.arange(len(command)) * TS
        start = command[0]
        u = np.column_stack([
            np.interp(at - self.delay, known, one) for one in (command - start).T
        ])  # fmt: skip
        q = [self._mode(mode, u, rate) for mode in self.modes]
        x = start[0] + sum(
            mode.moves[0] * position for mode, (position, _) in zip(self.modes, q, strict=True)
        )
        out = np.zeros((len(u), 6))
        for mode, both in zip(self.modes, q, strict=True):
            for axis in (0, 1):
                share = mode.moves[axis] + (x - MIDDLE) * mode.slope[axis]
                out[:, axis] += share * both[0]
                out[:, 2 + axis] += share * both[1]
        out[:, :2] += start
        return out

    @staticmethod
    def _mode(mode: SharedMode, u: Array, rate: float) -> tuple[Array, Array]:
        position, acceleration, den = mode.discrete(rate)
        taken = np.concatenate([[0.0], u @ mode.command])  # from the start on, at rest
        return (
            signal.lfilter(position, den, taken)[1:],
            signal.lfilter(acceleration, den, taken)[1:],
        )


def drawn_coupled(seed: int) -> tuple[CoupledMachine, str]:
    """Return a random printer and how it is coupled, a kind of KINDS.

    What a command does to the other axis is at its peak 5 to 30 % of what it does to its own, and
    either sign. Every second printer is an H-bot that racks as well.
    """
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    kinematics = ("corexy", "hbot")[seed // len(KINDS) % 2]
    x, y = sorted(rng.uniform(28.0, 60.0, 2), reverse=True)
    x = max(x, 1.15 * y)
    zx, zy = rng.uniform(0.04, 0.12, 2)
    size = float(rng.uniform(0.05, 0.3) * rng.choice([-1.0, 1.0]))
    if kind == "oblique":
        a = 0.5 * np.arcsin(min(abs(size) * 1.2, 1.0)) * np.sign(size)
        c, s = float(np.cos(a)), float(np.sin(a))
        modes = [SharedMode(x, zx, (c, s), (c, s)), SharedMode(y, zy, (-s, c), (-s, c))]
    else:
        along_x, along_y = (1.0, 0.0), (0.0, 1.0)
        modes = [SharedMode(x, zx, along_x, along_x), SharedMode(y, zy, along_y, along_y)]
        answer = int(rng.integers(2)) if kind == "constant" else 1
        hz = (x, y)[1 - answer], (y if kind == "shared" else float(rng.uniform(60.0, 85.0)))
        zeta = (zx, zy)[1 - answer], (zy if kind == "shared" else float(rng.uniform(0.04, 0.1)))
        taken, moved = (along_x, along_y) if answer else (along_y, along_x)
        slope = 1.0 / 60.0 if kind == "lever" else 0.0
        modes += _difference(hz, zeta, taken, moved, slope, size)
    machine = CoupledMachine(tuple(modes), float(rng.uniform(0.0, 2e-3)), kinematics)
    if kinematics == "hbot":
        gantry = 1.2 * max(float(rng.uniform(50.0, 80.0)), x)
        softness = (2.0 * np.pi * x) ** -2 - (2.0 * np.pi * gantry) ** -2
        racking = float(rng.uniform(1e-8, 3e-8)) / softness
        pair = _pair((x, gantry), (zx, 0.1), (1.0, 0.0), (0.0, 1.0), 1.0, racking)
        machine = replace(machine, modes=(*machine.modes, *pair))
    return machine, kind


def _difference(
    hz: Pair, zeta: Pair, taken: Pair, moved: Pair, slope: float, size: float
) -> list[SharedMode]:
    """Return two modes that cancel at rest, of a peak of ``size`` of the first one's own."""
    own = 1.0 / (2.0 * zeta[0])
    unit = CoupledMachine(tuple(_pair(hz, zeta, taken, moved, 0.0, 1.0)))
    peak = np.abs(unit.response(np.arange(5.0, 100.0, 0.25))).max()
    return _pair(hz, zeta, taken, moved, slope, size * own / float(peak))


def _pair(
    hz: Pair, zeta: Pair, taken: Pair, moved: Pair, slope: float, share: float
) -> list[SharedMode]:
    """Return two modes that cancel at rest; slope: per mm of x instead of the same everywhere."""
    parts = []
    for k, sign in ((0, 1.0), (1, -1.0)):
        moves = np.multiply(sign * share, moved)
        pair = float(moves[0]), float(moves[1])
        along = (slope * pair[0], slope * pair[1])
        parts.append(SharedMode(hz[k], zeta[k], taken, (0.0, 0.0) if slope else pair, along))
    return parts


def another_day(machine: CoupledMachine, seed: int, drift: float) -> CoupledMachine:
    """Return the printer with modes, damping and couplings changed by up to a share."""
    rng = np.random.default_rng(seed)

    def changed(mode: SharedMode) -> SharedMode:
        return replace(
            mode, hz=mode.hz * (1.0 + 0.2 * drift * rng.uniform(-1.0, 1.0)),
            damping=mode.damping * (1.0 + drift * rng.uniform(-1.0, 1.0)),
        )  # fmt: skip

    return replace(machine, modes=tuple(changed(mode) for mode in machine.modes))


def runs_of_days(
    days: Sequence[CoupledMachine], chip: Chip, seed: int, x: Sequence[float], y: Sequence[float],
) -> list[Run]:  # fmt: skip
    """Return runs of TEST_RESONANCES of x and of y at places (mm of x), on each day.

    Each run has a clock and a start of its own; the sensor stays as it is mounted.
    """
    rng = np.random.default_rng(seed + 999)
    runs: list[Run] = []
    for day, machine in enumerate(days):
        for direction, places in ((X, x), (Y, y)):
            for place in places:
                test = klipper(direction, point=(place, 147.5))
                worn = replace(chip, drift=float(rng.uniform(-0.02, 0.02)))
                it = recorded(machine, test, worn, seed, 1000 * seed + len(runs))
                found = find(it.recording, test)
                clock = found.start - float(it.recording.t[0]), found.drift
                name, command = f"{'xy'[direction == Y]}-{place:g}-{day}", found.test.command()
                runs.append(Run(name, command, it.recording, rough_clock=clock))
    return runs


__all__ = [
    "CoupledMachine",
    "SharedMode",
    "another_day",
    "drawn_coupled",
    "drawn_sensor",
    "runs_of_days",
]
