"""Printers whose axes slide with friction, with belts that have play and harden.

An axis is a row of bodies from the carriage to the nozzle. Body i hangs on body i − 1 by a spring
and a damper, and body 0 is what the belts' play leaves of the command:

    m_i x_i″ = F_i − F_{i+1} − m_i f_i
    F_i = k_i e_i (1 + h_i e_i²) + c_i e_i′,   e_i = x_{i−1} − x_i

A body slides in LuGre friction (Canudas de Wit, Olsson, Åström, Lischinsky, A new model for control
of systems with friction, 1995), a spring of bristles that gives way. Fans and motor steps shake a
printer, so that its bristles creep, at up to v₀ (dither, which makes friction smooth: Armstrong,
Dupont, Canudas de Wit, A survey of models …, 1994):

    z′ = v − (|v| F/g(v) + v₀) σ₀ z/F,   g(v) = F + (F_s − F) exp(−(v/v_s)²),   f = σ₀ z + σ₁ z′

While an axis slides fast, f is constant and brakes no ringing. In a hum, which turns around in
each period, it does. So a linear response to a sweep is not that to strokes. Friction that does
not creep shows this, too, but holds the nozzle up to F/ω² from its place after each stop: then
nothing linear compensates a print.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Complex
from tests.simulator import RATE, STEPS, compiled

MOST = 4  # bodies of an axis

SOURCE = r"""
#include <math.h>
#define BODIES 4
typedef struct { double level, stick, stribeck, creep, bristle, damping; } friction;
typedef struct { double k[BODIES], c[BODIES], h[BODIES], m[BODIES], play; friction f[BODIES];
                 int bodies, delay; } axis;
typedef struct { double x[BODIES + 1], v[BODIES + 1], z[BODIES]; } state;

static double rubbing(const friction *g, double v, double *z, double dt) {
  if (g->level <= 0) return 0;
  double ratio = v / g->stribeck, most = g->level * (1 + (g->stick - 1) * exp(-ratio * ratio));
  double rate = fabs(v) * g->bristle / most + g->creep, before = *z;
  double end = rate > 0 ? v / rate : before;
  *z = end + (before - end) * exp(-rate * dt);
  return g->bristle * *z + g->damping * (*z - before) / dt;
}

/* u (m) every `per` steps; out (n, 2): place and acceleration of the last body */
void slide(const double *u, long m, int per, double dt, const axis *g, double *out, long keep) {
  state s = {{0}};
  double half = g->play / 2, *x = s.x, *v = s.v;
  long n = (m - 1) * per, row = 0;
  for (long k = 0; k < n; k++) {
    double t = (double)(k - g->delay) / per, value = 0, force[BODIES + 2] = {0};
    if (t > 0) {
      long j = (long)t < m - 2 ? (long)t : m - 2;
      value = u[j] + (u[j + 1] - u[j]) * (t - j);
    }
    double led = value - x[0] > half ? value - half : value - x[0] < -half ? value + half : x[0];
    v[0] = (led - x[0]) / dt; x[0] = led;
    for (int i = 1; i <= g->bodies; i++) {
      double e = x[i - 1] - x[i], hard = 1 + g->h[i - 1] * e * e;
      force[i] = g->k[i - 1] * e * hard + g->c[i - 1] * (v[i - 1] - v[i]);
    }
    double a = 0;
    for (int i = 1; i <= g->bodies; i++) {
      a = (force[i] - force[i + 1]) / g->m[i - 1] - rubbing(&g->f[i - 1], v[i], &s.z[i - 1], dt);
      v[i] += a * dt; x[i] += v[i] * dt;
    }
    if ((k + 1) % keep == 0) { out[2 * row] = x[g->bodies]; out[2 * row + 1] = a; row++; }
  }
}
"""


@dataclass(frozen=True)
class Friction:
    """LuGre friction of a body on the frame.

    level: F, mm/s² of the body's mass; give: mm of motion in which it builds up, F/σ₀; creep: v₀,
    mm/s; stick: F_s/F; stribeck: v_s, mm/s; damping: ratio with which σ₁ damps a body that sticks.
    """

    level: float
    give: float = 0.01
    creep: float = 0.0
    stick: float = 1.0
    stribeck: float = 10.0
    damping: float = 0.2


@dataclass(frozen=True)
class Body:
    """A body and the spring that it hangs on.

    hz: of all that hangs on the spring, if it were rigid; damping: its ratio at that frequency;
    mass: any unit, the same for all; harder: share by which the spring is stiffer at 50 000 mm/s².
    """

    hz: float
    damping: float
    mass: float = 1.0
    friction: Friction | None = None
    harder: float = 0.0


@dataclass(frozen=True)
class SlidingAxis:
    """Bodies from the motor to the nozzle.

    play: mm that the belts can move by without moving anything; delay: s.
    """

    bodies: tuple[Body, ...]
    play: float = 0.0
    delay: float = 0.0

    def response(self, hz: Array) -> Complex:
        """Return the response (k,) without friction, play and hardening: nozzle per command."""
        stages = self._stages()
        s, n = 2j * np.pi * hz, len(stages)
        A = np.zeros((len(hz), n, n), complex)
        for i, (k, c, m, _) in enumerate(stages):
            spring = k + c * s
            A[:, i, i] += m * s**2 + spring
            if i:
                A[:, i - 1, i - 1] += spring
                A[:, i - 1, i] -= spring
                A[:, i, i - 1] -= spring
        b = np.zeros((len(hz), n, 1), complex)
        b[:, 0, 0] = stages[0][0] + stages[0][1] * s
        return np.asarray(np.linalg.solve(A, b)[:, -1, 0] * np.exp(-s * self.delay))

    def _stages(self) -> list[tuple[float, float, float, float]]:
        """Return k, c, m and h of each body."""
        stages = []
        for i, body in enumerate(self.bodies):
            w, hung = 2.0 * np.pi * body.hz, sum(each.mass for each in self.bodies[i:])
            k, stretch = w * w * hung, 50000.0 / w**2
            stages.append((k, 2.0 * body.damping * w * hung, body.mass, body.harder / stretch**2))
        return stages

    def packed(self) -> _Axis:
        columns = list(zip(*self._stages(), strict=True))
        k, c, m, h = ((ctypes.c_double * MOST)(*column) for column in columns)
        rubbing = (_Friction * MOST)(*(_rubbing(body.friction) for body in self.bodies))
        return _Axis(k, c, h, m, self.play, rubbing, len(self.bodies), round(self.delay * RATE))


@dataclass(frozen=True)
class SlidingMachine:
    """A printer of two such axes that do not move each other."""

    x: SlidingAxis
    y: SlidingAxis
    kinematics: str = "corexy"

    def played(self, command: Array, keep: int = STEPS, step: float = 0.0) -> Array:
        """Return x, y, their accelerations, and twice 0, as ``Machine.played`` does."""
        assert not step
        start = command[0]
        out = np.zeros(((len(command) - 1) * STEPS // keep, 6))
        for k, axis in enumerate((self.x, self.y)):
            out[:, [k, 2 + k]] = played(axis, command[:, k] - start[k], keep)
        out[:, :2] += start
        return out


def played(axis: SlidingAxis, command: Array, keep: int = STEPS) -> Array:
    """Return place and acceleration (n, 2) of the nozzle, every ``keep`` / 20 kHz; from 0."""
    u = np.ascontiguousarray(command)
    out = np.zeros(((len(u) - 1) * STEPS // keep, 2))
    compiled(SOURCE).slide(
        ctypes.c_void_p(u.ctypes.data), ctypes.c_long(len(u)), STEPS,
        ctypes.c_double(1.0 / RATE), ctypes.byref(axis.packed()),
        ctypes.c_void_p(out.ctypes.data), ctypes.c_long(keep),
    )  # fmt: skip
    return out


class _Friction(ctypes.Structure):
    _fields_ = [
        (name, ctypes.c_double)
        for name in ("level", "stick", "stribeck", "creep", "bristle", "damping")
    ]


class _Axis(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_double * MOST) for name in ("k", "c", "h", "m")),
        ("play", ctypes.c_double), ("friction", _Friction * MOST),
        ("bodies", ctypes.c_int), ("delay", ctypes.c_int),
    ]  # fmt: skip


def _rubbing(f: Friction | None) -> _Friction:
    if f is None:
        return _Friction()
    bristle = f.level / f.give
    damping = 2.0 * f.damping * np.sqrt(bristle)
    return _Friction(f.level, f.stick, f.stribeck, f.creep / f.give, bristle, damping)


# ---------------------------------------------------------------------- random printers

KINDS = ("friction", "play", "hardening", "mixed")


def drawn_sliding(seed: int) -> tuple[SlidingMachine, str]:
    """Return a random printer and which of KINDS it has.

    Level and creep are those with which a typical axis shows what recordings of a real one do,
    a Marlin printer's y: of its strokes a response to its sweep explains hardly more than none, and
    one to other strokes a third more (``test_nonlinear_printers``). 5 to 9 m/s² are 2.5 to 4.5 N
    on half a kilogram, of rails with seals, wheels under preload, idlers and the motors' detent.
    The rest is as usual: presliding of 5 to 30 µm (ball guides: Al-Bender, Lampaert, Swevers 2005),
    F_s up to 1.4 F, play of up to 20 µm, and belts up to half as stiff again where a resonance
    makes 5000 mm/s² tenfold.
    """
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]

    def axis() -> SlidingAxis:
        part = 0.5 if kind == "mixed" else 1.0
        friction = Friction(
            float(rng.uniform(5000.0, 9000.0)), float(rng.uniform(0.005, 0.03)),
            float(rng.uniform(5.0, 20.0)), float(rng.uniform(1.0, 1.4)),
            float(rng.uniform(5.0, 30.0)),
        )  # fmt: skip
        play, harder = part * rng.uniform(0.005, 0.02), part * rng.uniform(0.1, 0.5)
        carriage = Body(
            float(rng.uniform(32.0, 55.0)), float(rng.uniform(0.04, 0.12)), 1.0,
            friction if kind in ("friction", "mixed") else None,
            float(harder) if kind in ("hardening", "mixed") else 0.0,
        )  # fmt: skip
        nozzle = Body(
            float(rng.uniform(60.0, 85.0)), float(rng.uniform(0.03, 0.06)),
            float(rng.uniform(0.15, 0.45)),
        )  # fmt: skip
        return SlidingAxis((carriage, nozzle), float(play) if kind in ("play", "mixed") else 0.0)

    return SlidingMachine(axis(), axis()), kind
