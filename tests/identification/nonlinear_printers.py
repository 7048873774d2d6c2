"""``python -m tests.identification.nonlinear_printers``: models from sweeps and from strokes.

A seed gives each printer its friction, play and hardening belts (`tests.friction_printers`). Each
is measured by each of MOTIONS, and every model compensates the rectangle at 10 000 and 3 000 mm/s²
and the first layers of a cube. Columns are RMS contour errors in µm, the shaper's with the settings
that are best on the printer itself.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy import linalg, signal

from hframe_post.arrays import TS, Array, Complex, X, Y, Z
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import SampleStream
from hframe_post.identification.recordings import strokes
from hframe_post.identification.recordings.sweep import runs as sweeps
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.model.shapers import AxisShaping
from hframe_post.prediction.predict import contour_error
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from hframe_post.stream.running import one_blas_thread
from hframe_post.studies.inputs import rectangle
from tests.friction_printers import KINDS, SlidingAxis, SlidingMachine, drawn_sliding, played
from tests.native.oracles import in_motion
from tests.random_printers import cube
from tests.resonance_recordings import klipper
from tests.simulator import RATE, STEPS

NOISE = 90.0  # mm/s² of a sample at 1 kHz, an ADXL345's
PLACE = (140.0, 147.5)
PATHS = ("rectangle", "rectangle 3000", "cube")
SHAPERS = ("zv", "mzv", "ei")


# ---------------------------------------------------------------------- motions


@cache
def profile() -> Printer:
    """Return the paper's printer, as one that does not rack."""
    paper = load("paper")
    return replace(paper, plant=replace(paper.plant, Gxtheta=None))


@cache
def motion(name: str, axis: int) -> Array:
    """Return the command (n, 2) that measures an axis, mm every 1 ms."""
    direction = (1.0, 0.0) if axis == X else (0.0, 1.0)
    if name == "strokes":
        return strokes.command(profile(), PLACE)
    if name == "gentle strokes":  # as a slice with the limits of the cube has them
        limits = replace(profile().limits, velocity=100.0, acceleration=2500.0)
        return strokes.command(replace(profile(), limits=limits), PLACE)
    if name == "sweep":
        return sweeps(profile(), axis, [PLACE])[0].command
    if name == "sweeping":  # TEST_RESONANCES of today
        return klipper(direction).command()
    assert name == "pulses"  # that of before December 2024
    return klipper(direction, sweeping_period=0.0).command()


KNOWN_START = ("strokes", "gentle strokes", "sweep")
MOTIONS = (*KNOWN_START, "sweeping", "pulses")


# ---------------------------------------------------------------------- measurement and model


def accelerations(command: Array) -> Array:
    """Return the acceleration (n,) of a command (n,), mm/s²."""
    return np.pad(np.diff(command, 2), 1) / TS**2


def measured(axis: SlidingAxis, command: Array, seed: int) -> Array:
    """Return what a sensor on the nozzle shows (n,), mm/s², on the clock of the command (n,)."""
    taps = signal.firwin(801, 400.0, fs=RATE)
    a = played(axis, command - command[0], 1)[:, 1]
    a = np.append(0.0, signal.oaconvolve(a, taps, "same"))[::STEPS]
    return np.asarray(a + np.random.default_rng(seed).normal(0.0, NOISE, len(a)))


@dataclass(frozen=True)
class Estimate:
    """An impulse response h = δ + g (m,) from commanded to measured acceleration, at 1 ms."""

    g: Array
    lag: float

    def foreseen(self, u: Array) -> Array:
        """Return the acceleration (n,) that a commanded one causes."""
        return np.asarray(u + signal.oaconvolve(u, self.g)[: len(u)])

    def response(self) -> ImpulseResponse:
        """Return it as what acceleration does to the nozzle's place."""
        g = self.g.copy()
        g[:2] += self.lag, -self.lag
        q = np.append(0.0, np.cumsum(np.cumsum(g)))
        end = len(q) // 4
        q[-end:] *= 0.5 + 0.5 * np.cos(np.pi * np.arange(end) / end)
        return ImpulseResponse(q, 0, lag=self.lag)


@one_blas_thread()
def estimated(u: Array, a: Array, known_start: bool = True, m: int = 300) -> Estimate:
    """Return the response from u to a (n,), by regularised least squares.

    The kernel's size and decay and the noise are those of greatest likelihood. Below a quarter of
    the resonance the gain is one mode's, and without a known start the phase is none.
    """
    F = int(2 ** np.ceil(np.log2(len(u) + m)))
    hz = np.asarray(np.fft.rfftfreq(F, TS), dtype=np.float64)
    U, E = np.fft.rfft(u, F), np.fft.rfft(a - u, F)
    band, k = (hz > 3.0) & (hz < 150.0), np.arange(m, dtype=float)
    rows, wanted = _rest(_resonance(hz, U, E + U), k, known_start)
    W = band.astype(float)
    for _ in range(2):
        power, total = np.abs(U) ** 2 * W, float(np.fft.irfft(np.abs(E) ** 2 * W, F)[0])
        A = linalg.toeplitz(np.fft.irfft(power, F)[:m])
        b = np.fft.irfft(np.conj(U) * E * W, F)[:m]
        K, noise = _hyperparameters(A, b, total, F * float(band.mean()))
        g = linalg.solve(
            A / noise + linalg.inv(K) + rows.T @ rows, b / noise + rows.T @ wanted, assume_a="pos"
        )
        left = _smooth(np.square(np.abs(E - np.fft.rfft(g, F) * U)), hz, 3.0)
        W = np.where(band, 1.0 / np.maximum(left, 1e-3 * left[band].max()), 0.0)
    return Estimate(g, float(k @ g) if known_start else 0.0)


def _rest(f0: float, k: Array, known_start: bool) -> tuple[Array, Array]:
    """Return what is known of g as rows (r, m) and their values (r,): gain 1 at rest, one mode."""
    hz = np.arange(1.0, f0 / 4.0)
    sd = 0.05 * (hz / f0) ** 2 + 2e-5
    E = np.exp(-2j * np.pi * TS * np.outer(hz, k)) / sd[:, None]
    rows = [np.ones((1, len(k))) / 1e-5, E.real]
    values = [np.zeros(1), (1.0 / (1.0 - (hz / f0) ** 2) - 1.0) / sd]
    if not known_start:
        rows += [E.imag, k[None] / 1e-3]
        values += [np.zeros(len(hz) + 1)]
    return np.vstack(rows), np.concatenate(values)


def _hyperparameters(A: Array, b: Array, total: float, n: float) -> tuple[Array, float]:
    """Return the kernel and the noise of greatest likelihood."""
    k, best = np.arange(len(b)), (np.inf, A, 0.0)
    for decay in (0.965, 0.98, 0.99):
        for size in (0.05, 0.15):
            K = size**2 * np.outer(decay**k, decay**k) * 0.9 ** np.abs(k[:, None] - k)
            K += np.diag(1e-9 * size**2 * decay ** (2.0 * k) + 1e-14)
            L = linalg.cholesky(K, lower=True)
            values, V = linalg.eigh(L.T @ A @ L)
            seen = (V.T @ (L.T @ b)) ** 2
            for noise in np.geomspace(1e-4, 1.0, 13) * total / n:
                d = values + noise
                cost = (total - (seen / d).sum()) / noise + np.log(d / noise).sum()
                best = min(best, (cost + n * np.log(noise), K, noise), key=lambda one: one[0])
    return best[1], best[2]


def _resonance(hz: Array, U: Complex, A: Complex) -> float:
    power = _smooth(np.abs(U) ** 2, hz, 1.0)
    cross = np.conj(U) * A
    H = _smooth(cross.real, hz, 1.0) + 1j * _smooth(cross.imag, hz, 1.0)
    H /= np.maximum(power, 1e-9 * power.max())
    return float(hz[np.argmax(np.where((hz > 18.0) & (hz < 95.0), np.abs(H), 0.0))])


def _smooth(values: Array, hz: Array, width: float) -> Array:
    n = max(int(width / hz[1]), 1)
    return np.convolve(values, np.ones(n) / n, "same")


def plant(machine: SlidingMachine, name: str, seed: int = 0) -> Plant:
    """Return the plant that a motion shows of the machine."""
    G = []
    for k, axis in ((X, machine.x), (Y, machine.y)):
        command = motion(name, k)[:, k]
        a = measured(axis, command, 2 * seed + k)
        G.append(estimated(accelerations(command), a, name in KNOWN_START).response())
    return Plant(G[X], G[Y], None, PLACE[X])


# ---------------------------------------------------------------------- a sweep between strokes


@dataclass(frozen=True)
class Shares:
    """Shares of the acceleration, 5 to 100 Hz, that models leave of an axis.

    Of the strokes: a rigid axis, and responses to the sweep and to the other strokes. loud: how
    much of the response to strokes the sweep shows.
    """

    rigid: float
    swept: float
    struck: float
    loud: float


def shares(axis: SlidingAxis, seed: int = 0) -> Shares:
    """Return what the axis shows of strokes (4000 mm/s², 10 mm, to and fro), a sweep, strokes.

    The motion is that of published recordings of a Marlin printer's y: there the shares are 57 to
    61, 55 to 58 and 37 to 41 %, and 35 % are loud.
    """
    ramp, phase = np.repeat([1.0, -1.0, 1.0], (50, 100, 50)), np.arange(18.75, step=TS)
    hz = 5.0 + 4.0 * phase
    fade = np.minimum(1.0, np.minimum(phase, phase[::-1]) / 0.5)
    hum = fade * np.sin(2.0 * np.pi * (5.0 * phase + 2.0 * phase**2)) / (2.0 * np.pi * hz) ** 2
    stroke, rest = np.cumsum(np.cumsum(ramp)) * TS**2, np.zeros(1000)
    parts = [rest, stroke, rest, hum, rest, -stroke, rest]
    command = 4000.0 * np.concatenate(parts)
    first, last = slice(500, 2200), slice(len(command) - 1700, len(command))
    u, a = accelerations(command), measured(axis, command, seed)
    sos = signal.butter(4, [5.0, 100.0], "band", fs=1.0 / TS, output="sos")

    def band(values: Array) -> Array:
        return np.asarray(signal.sosfiltfilt(sos, values))

    def left(foreseen: Array, of: slice) -> float:
        seen = band(a)[of]
        return float(np.linalg.norm(seen - band(foreseen)[of]) / np.linalg.norm(seen))

    sweep = slice(2200, len(command) - 2200)
    swept = estimated(u[sweep], a[sweep], known_start=False).foreseen(u)
    struck = estimated(u[first], a[first]).foreseen(u)
    p, seen = band(struck)[sweep], band(a)[sweep]
    return Shares(left(u, last), left(swept, last), left(struck, last), float(p @ seen / (p @ p)))


# ---------------------------------------------------------------------- prints


@dataclass(frozen=True)
class Print:
    """A print's path (n, 2) in mm, its command with a strategy, and which samples count."""

    path: Array
    command: Array
    moving: Array

    def error(self, machine: SlidingMachine, command: Array) -> float:
        """Return the RMS contour error of a command (n, 2), µm."""
        nozzle = np.vstack([command[:1], machine.played(command)[:, :Z]])
        off = contour_error(self.path, nozzle)[self.moving]
        return 1e3 * float(np.sqrt((off**2).mean()))

    def shaped(self, shaping: Sequence[AxisShaping]) -> Array:
        """Return the command (n, 2) behind a shaper of each axis."""
        runs = [one.shaper.run(self.path[:, k]) for k, one in enumerate(shaping)]
        return np.column_stack(runs)


def lines(path: str) -> list[bytes]:
    """Return the G-code of one of PATHS."""
    if path == "cube":
        return cube()
    speed = b"S3000" if path == "rectangle 3000" else b"S10000"
    return [line.replace(b"S10000", speed) for line in rectangle(profile())]


def printed(path: str, strategy: str = "none", model: Plant | None = None) -> Print:
    """Return one of PATHS, compensated by a model."""
    own = profile() if model is None else replace(profile(), plant=model)
    commands = SampleStream(lines(path), own, Options(strategy, clamp=True), (strategy,))
    chunks = [chunk for chunk in commands.computed() if len(chunk)]
    return Print(
        np.concatenate([chunk.xyze[:, :Z] for chunk in chunks]),
        np.concatenate([chunk.commands[strategy] for chunk in chunks]),
        np.concatenate([in_motion(chunk.xyze)[1] for chunk in chunks]),
    )


@cache
def uncompensated(path: str) -> Print:
    return printed(path)


def best_shaper(machine: SlidingMachine, wanted: Print) -> tuple[AxisShaping, ...]:
    """Return the shaper that is best on the printer itself, by search along one axis at a time."""

    def cost(shaping: tuple[AxisShaping, ...]) -> float:
        return wanted.error(machine, wanted.shaped(shaping))

    return min((_searched(name, cost) for name in SHAPERS), key=cost)


def _searched(
    name: str, cost: Callable[[tuple[AxisShaping, ...]], float]
) -> tuple[AxisShaping, ...]:
    best: tuple[AxisShaping, ...] = (AxisShaping(name, 45.0, 0.08),) * 2
    least = cost(best)
    for factors in (np.geomspace(0.6, 2.2, 14), (0.92, 0.96, 1.04, 1.08), (0.98, 1.02)):
        for axis in (Y, X):
            at = best[axis]
            for factor in factors:
                for damping in (0.03, 0.08, 0.13):
                    tried = list(best)
                    tried[axis] = AxisShaping(name, at.hz * float(factor), damping)
                    if (one := cost(tuple(tried))) < least:
                        best, least = tuple(tried), one
    return best


def errors(
    machine: SlidingMachine, motions: Sequence[str] = MOTIONS, seed: int = 0,
    paths: Sequence[str] = PATHS, shapers: bool = True,
) -> dict[str, dict[str, float]]:  # fmt: skip
    """Return the contour error (µm) of each path: none, shaper, and a model from each motion.

    The cube's shaper is that of the rectangle.
    """
    models = {name: plant(machine, name, seed) for name in motions}
    found: dict[str, dict[str, float]] = {}
    shaping: tuple[AxisShaping, ...] = ()
    for path in paths:
        wanted = uncompensated(path)
        row = found[path] = {"none": wanted.error(machine, wanted.path)}
        if shapers:
            shaping = best_shaper(machine, wanted) if path != "cube" else shaping
            row["shaper"] = wanted.error(machine, wanted.shaped(shaping))
        for name, model in models.items():
            done = printed(path, "racking", model)
            row[name] = done.error(machine, done.command)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=24, help="number of printers")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first printer")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.count)
    rows = []
    for seed in seeds:
        machine, kind = drawn_sliding(seed)
        found = errors(machine, seed=seed)
        rows.append((kind, found))
        for path in PATHS:
            text = ", ".join(f"{name} {um:.1f}" for name, um in found[path].items())
            print(f"{seed} {kind}, {path}: {text}", flush=True)
    for kind in (*KINDS, "all"):
        own = [found for each, found in rows if kind in (each, "all")]
        for path in PATHS if own else ():
            columns = [f"{kind}, {path}, median:"]
            for name in own[0][path]:
                columns.append(f"{name} {np.median([found[path][name] for found in own]):.1f}")
            for name in ("shaper", *MOTIONS[1:]):
                ratio = np.median([found[path]["strokes"] / found[path][name] for found in own])
                columns.append(f"strokes/{name} {ratio:.2f}")
            print(" ".join(columns))


if __name__ == "__main__":
    main()
