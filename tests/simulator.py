"""A printer and its accelerometer in continuous time, independent of the package's own model.

Motors move along straight lines between the samples of a command. Each axis is a sum of modes,
stepped at 20 kHz, behind a delay and belt play, with Coulomb friction on its first mode and
belts that stiffen. On an H-bot the force along x turns the gantry, which has a mode of its own:

    q_i″ = ω_i²(u − q_i) − 2ζ_iω_i q_i′,   x = Σ s_i q_i,   θ″ = ω²(κx″ − θ) − 2ζωθ′
"""

import ctypes
import functools
import hashlib
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import signal
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from hframe_post.arrays import TS, Array
from hframe_post.identification.recordings.accelerometer import GRAVITY, Recording
from hframe_post.model.impulse_response import LONGEST, ImpulseResponse
from hframe_post.model.plant import Plant

RATE = 20000
STEPS = 20  # a millisecond
ADXL345 = 76.5  # mm/s², its least step at 16 g
BEGUN = 1234.5  # s of a recording's clock, when the motion begins

SOURCE = r"""
#include <math.h>
#include <string.h>
#define MODES 4
typedef struct { double w[MODES], z[MODES], share[MODES], friction, play, second, third, along;
                 int modes, delay; } axis;
static void step(const axis *g, double u, double scale, double *q, double *v, double *x,
                 double *a, double dt) {
  *x = *a = 0;
  for (int i = 0; i < g->modes; i++) {
    double w = g->w[i] * scale, e = u - q[i], size = 50000.0 / (w * w);
    double pull = e * (1.0 + 2.0 * g->second * e / size + 4.0 * g->third * e * e / (size * size));
    double force = w * w * pull - 2.0 * g->z[i] * w * v[i], before = v[i];
    double after = v[i] + force * dt;
    if (i == 0 && g->friction > 0) {
      double most = g->friction * dt;
      after = fabs(after) <= most ? 0.0 : after - copysign(most, after);
    }
    double acceleration = (after - before) / dt;
    v[i] = after; q[i] += after * dt;
    *x += g->share[i] * q[i]; *a += g->share[i] * acceleration;
  }
}
/* u (m, 2) every `per` steps; out (n, 6): x, y of the nozzle, their accelerations, theta,
   theta'' */
void simulate(const double *u, long m, int per, double dt, const axis *g, double wt, double zt,
              double kappa, double x_c, double x0, double at, double *out, long keep) {
  double q[2][MODES] = {{0}}, v[2][MODES] = {{0}}, slack[2] = {0, 0}, th = 0, dth = 0;
  long n = (m - 1) * per, row = 0;
  for (long k = 0; k < n; k++) {
    double x[2], a[2];
    for (int c = 0; c < 2; c++) {
      double t = (double)(k - g[c].delay) / per;
      double value = 0;
      if (t > 0) { long j = (long)t; if (j > m - 2) j = m - 2; double f = t - j;
        value = u[2 * j + c] * (1 - f) + u[2 * j + 2 + c] * f; }
      double half = g[c].play / 2;
      if (value - slack[c] > half) slack[c] = value - half;
      if (value - slack[c] < -half) slack[c] = value + half;
      double scale = 1.0 + g[c].along * (x0 + u[2 * (k / per)] - at);
      step(&g[c], half > 0 ? slack[c] : value, scale, q[c], v[c], &x[c], &a[c], dt);
    }
    double scale = 1.0 + g[0].along * (x0 + u[2 * (k / per)] - at), w = wt * scale;
    double ddth = w * w * (kappa * a[0] - th) - 2 * zt * w * dth;
    dth += ddth * dt; th += dth * dt;
    if ((k + 1) % keep == 0) {
      double arm = x0 + x[0] - x_c, *o = out + 6 * row++;
      o[0] = x[0]; o[1] = x[1] + arm * th; o[2] = a[0]; o[3] = a[1] + arm * ddth;
      o[4] = th; o[5] = ddth;
    }
  }
}
"""


@dataclass(frozen=True)
class Mode:
    """A resonance; share: of the motion at rest."""

    hz: float
    damping: float
    share: float = 1.0


@dataclass(frozen=True)
class Axis:
    """The dynamics between motors and nozzle along one axis.

    delay: s; friction: mm/s²; play: mm; second, third: share of harmonics where a resonance makes
    5000 mm/s² tenfold.
    """

    modes: tuple[Mode, ...]
    delay: float = 0.0
    friction: float = 0.0
    play: float = 0.0
    second: float = 0.0
    third: float = 0.0

    @property
    def linear(self) -> bool:
        return not any((self.friction, self.play, self.second, self.third))


@dataclass(frozen=True)
class Machine:
    """A printer: its axes, and its racking (rad per mm/s², 0: none) with its mode.

    along: relative change of all frequencies per mm of x, from ``middle``.
    """

    x: Axis
    y: Axis
    racking: float = 0.0
    racking_mode: Mode = Mode(55.0, 0.1)
    x_c: float = 140.0
    along: float = 0.0
    middle: float = 140.0
    kinematics: str = "hbot"

    @property
    def linear(self) -> bool:
        return self.x.linear and self.y.linear and self.along == 0.0

    def exact(self) -> Plant:
        """Return the plant of a linear machine, by what one pulse of acceleration does to it."""
        u = np.arange(LONGEST, dtype=np.float64)  # mm: at 1 mm/ms from the first sample on
        along_x, along_y = (self.played(np.outer(u, way)) for way in np.eye(2))
        Gxx, Gyy = (_axis(moved - u[1:]) for moved in (along_x[:, 0], along_y[:, 1]))
        if not self.racking:
            return Plant(Gxx, Gyy, None, self.x_c)
        return Plant(Gxx, Gyy, ImpulseResponse(_ended(along_x[:, 4]), 0, 0.0), self.x_c)

    def played(self, command: Array, keep: int = STEPS, step: float = 0.0) -> Array:
        """Return x, y, their accelerations, θ and θ″ (n, 6) of the nozzle, every ``keep`` / 20 kHz.

        command (m, 2): mm every 1 ms, from rest. The first row is at one step after the start.
        step: mm of belt for one motor step; 0: the motors follow straight lines.
        """
        start = command[0]
        u, per = np.ascontiguousarray(command - start), STEPS
        if step:
            u, per = self._stepped(command, step) - start, 1
        m = len(u)
        out = np.zeros(((m - 1) * per // keep, 6))
        both = (_Axis * 2)(*(_packed(axis, self.along) for axis in (self.x, self.y)))
        number = ctypes.c_double
        compiled(SOURCE).simulate(
            _pointer(u), ctypes.c_long(m), per, number(1.0 / RATE), both,
            number(2.0 * np.pi * self.racking_mode.hz), number(self.racking_mode.damping),
            number(self.racking), number(self.x_c), number(start[0]), number(self.middle),
            _pointer(out), ctypes.c_long(keep),
        )  # fmt: skip
        out[:, :2] += start
        return out

    def _stepped(self, command: Array, step: float) -> Array:
        """Return the command every 50 µs, with both motors rounded to whole steps like Klipper."""
        at = np.arange((len(command) - 1) * STEPS + 1) / STEPS
        x, y = (np.interp(at, np.arange(len(command)), one) for one in command.T)
        if self.kinematics == "cartesian":
            return np.ascontiguousarray(np.column_stack([x, y]) / step).round() * step
        A, B = (np.round(one / step) * step for one in (x + y, x - y))
        return np.column_stack([A + B, A - B]) / 2.0


@dataclass(frozen=True)
class Chip:
    """An accelerometer: gains by axis, cross-axis terms, tilt, steps, noise, uneven times.

    rate_error: of its sampling, visible in its times; drift: of its times; offset: from the
    nozzle to the sensor (x, y), mm; filtered: without frequencies above half the rate.
    """

    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    cross: float = 0.0
    turned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bias: tuple[float, float, float] = (120.0, -80.0, 250.0)
    step: float = ADXL345
    noise: float = 4.0  # mm/s²/√Hz
    jitter: float = 2e-6
    rate: float = 3200.0
    rate_error: float = 0.0
    drift: float = 0.0
    lead: float = 0.0
    offset: tuple[float, float] = (0.0, 0.0)
    filtered: bool = False

    def record(self, machine: Machine, command: Array, seed: int, step: float = 0.0) -> Recording:
        """Return its recording while the machine plays the command. step: as in ``played``."""
        motion = machine.played(command, 1, step)
        grid = np.arange(len(motion)) / RATE
        ax = motion[:, 2] - self.offset[1] * motion[:, 5]
        ay = motion[:, 3] + self.offset[0] * motion[:, 5]
        if self.filtered:
            taps = signal.firwin(2 * int(5 * RATE / self.rate) + 1, 0.45 * self.rate, fs=RATE)
            ax, ay = (signal.oaconvolve(one, taps, "same") for one in (ax, ay))

        def felt(t: Array) -> Array:
            return np.column_stack([np.interp(t, grid, one, 0.0, 0.0) for one in (ax, ay)])

        return self._sampled(felt, len(motion) / RATE, seed)

    def on_nozzle(self, x: Array, y: Array, seed: int = 0) -> Recording:
        """Return its recording of a nozzle that moves through x and y, mm every 1 ms."""
        whole, xy = (len(x) - 1) * TS, np.column_stack([x, y])
        motion = make_interp_spline(np.arange(len(x)) * TS, xy, 9).derivative(2)

        def felt(t: Array) -> Array:
            playing = (t >= 0.0) & (t <= whole)
            return np.where(playing[:, None], motion(np.clip(t, 0.0, whole)), 0.0)

        return self._sampled(felt, whole, seed)

    def _sampled(self, felt: Callable[[Array], Array], seconds: float, seed: int) -> Recording:
        """Return its recording of accelerations that times t (n,) in s have, (n, 2) in mm/s²."""
        rng = np.random.default_rng(seed)
        t = np.arange(-self.lead, seconds + self.lead, 1.0 / (self.rate * (1.0 + self.rate_error)))
        t += rng.uniform(0.0, 1.0 / self.rate) + rng.normal(0.0, self.jitter, len(t))
        a = np.column_stack([felt(t), np.full(len(t), GRAVITY)])
        a = Rotation.from_euler("ZYX", self.turned, degrees=True).inv().apply(a)
        mixing = np.diag(self.gains) + self.cross * (np.ones((3, 3)) - np.eye(3))
        a = a @ mixing.T + self.bias
        a += rng.normal(0.0, 1.0, a.shape) * self.noise * np.sqrt(self.rate / 2.0)
        a = np.round(a / self.step) * self.step
        return Recording(BEGUN + t * (1.0 + self.drift), a, self.lead == 0.0)


# ---------------------------------------------------------------------- the C part


class _Axis(ctypes.Structure):
    _fields_ = [
        ("w", ctypes.c_double * 4), ("z", ctypes.c_double * 4), ("share", ctypes.c_double * 4),
        ("friction", ctypes.c_double), ("play", ctypes.c_double), ("second", ctypes.c_double),
        ("third", ctypes.c_double), ("along", ctypes.c_double), ("modes", ctypes.c_int),
        ("delay", ctypes.c_int),
    ]  # fmt: skip


def _packed(axis: Axis, along: float) -> _Axis:
    def four(values: list[float]) -> ctypes.Array[ctypes.c_double]:
        return (ctypes.c_double * 4)(*values)

    return _Axis(
        four([2.0 * np.pi * mode.hz for mode in axis.modes]),
        four([mode.damping for mode in axis.modes]),
        four([mode.share for mode in axis.modes]),
        axis.friction, axis.play, axis.second, axis.third, along, len(axis.modes),
        round(axis.delay * RATE),
    )  # fmt: skip


def _pointer(values: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.ctypes.data)


@functools.cache
def compiled(source: str) -> ctypes.CDLL:
    """Return the functions of a C source, compiled once on a machine."""
    name = hashlib.sha256(source.encode()).hexdigest()[:16]
    target = Path(tempfile.gettempdir()) / f"hframe-post-simulator-{name}.so"
    if not target.exists():
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / target.name
            command = ["gcc", "-O2", "-shared", "-fPIC", "-xc", "-", "-o", str(made), "-lm"]
            subprocess.run(command, input=source.encode(), check=True)
            shutil.move(made, target)
    return ctypes.CDLL(str(target))


def _axis(off: Array) -> ImpulseResponse:
    """Return the response of an axis that is off its command by so much, mm, from 1 ms on."""
    lag = -float(off[-1])
    return ImpulseResponse(_ended(off + lag), 0, lag=lag)


def _ended(deviation: Array) -> Array:
    """Return a deviation from its pulse on, without the end in which hardly anything moves."""
    size = np.abs(deviation)
    return np.append(0.0, deviation[: int(np.flatnonzero(size > 1e-5 * size.max())[-1]) + 1])
