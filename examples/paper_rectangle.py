"""The paper's rectangle through the library, step by step, with figures.

Run it whole (``python examples/paper_rectangle.py FOLDER``), or cell by cell in an editor that
knows ``# %%``. It needs matplotlib: ``pip install matplotlib``. Lengths are mm, times s,
one sample is 1 ms. The equations are those of arXiv 2105.09878.
"""

# %% [1] A printer: its limits, its plant (Gxx, Gyy and racking, Gxθ), its window
from __future__ import annotations

import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import hframe_post as hp

FOLDER = Path(sys.argv[1] if len(sys.argv) > 1 else "rectangle")
FOLDER.mkdir(parents=True, exist_ok=True)
printer = hp.load_printer("paper")
plant = printer.plant
print(f"{printer.description}: Gxx of {len(plant.Gxx.deviation)} ms, x_c = {plant.x_c:g} mm")

# %% [2] What the nozzle makes of the motors' motion, by frequency (Fig. 4 and 5)
hz = np.geomspace(1.0, 200.0, 400)
omega = 2.0 * np.pi * hz * 1e-3  # radians a sample
figure = Figure(figsize=(7, 4), layout="constrained")
axis = figure.subplots()
for name, G in (("Gxx", plant.Gxx), ("Gyy", plant.Gyy)):
    axis.semilogx(hz, 20.0 * np.log10(np.abs(G.response(omega))), label=name)
assert plant.Gxtheta is not None
lever = 60.0  # mm from x_c, where a turn of the gantry moves the nozzle most in the paper
racking = np.abs(plant.Gxtheta.response(omega)) * lever
axis.semilogx(hz, 20.0 * np.log10(racking), label=f"racking, y by x, {lever:g} mm from x_c")
axis.set(xlabel="frequency, Hz", ylabel="mm/mm, dB", ylim=(-60, 15))
axis.legend()
figure.savefig(FOLDER / "plant.svg")

# %% [3] The path: 120 × 20 mm, 150 mm/s, 10 m/s², from rest to rest on each side (Fig. 7)
SPEED, ACCELERATION, TS = 150.0, 1e4, 1e-3


def side(start: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Return a straight move from rest to rest, (n, 2): accelerate, cruise, brake."""
    length = float(np.hypot(*by))
    ramp = SPEED / ACCELERATION
    cruise = length / SPEED - ramp
    t = np.arange(0.0, cruise + 2.0 * ramp + TS / 2.0, TS)
    velocity = SPEED * np.clip(np.minimum(t, t[::-1]) / ramp, 0.0, 1.0)
    s = np.cumsum(velocity)
    return start + np.outer(s / s[-1], by)


y = round(sum(printer.travel.y) / 2.0) - 10.0
corners = np.array([(0.0, 0.0), (120.0, 0.0), (120.0, 20.0), (0.0, 20.0), (0.0, 0.0)])
corners += (plant.x_c, y)
path = np.concatenate([side(a, b - a) for a, b in pairwise(corners)])
print(f"{len(path)} samples, {len(path) * TS:.2f} s")

# %% [4] Commands by limited-preview filtered B-splines, and where the nozzle goes (Fig. 9)
STRATEGIES = {"none": "no compensation", "fbs": "ringing only", "racking": "ringing and racking"}
nozzle, error, rms = {}, {}, {}
for strategy in STRATEGIES:
    command = hp.compensate(path, printer, strategy)  # leads and settles: longer than the path
    nozzle[strategy] = hp.predict(command, printer)  # eq. 1 and 2
    error[strategy] = hp.contour_error(nozzle[strategy], path)  # (n,)
    rms[strategy] = float(np.sqrt(np.mean(error[strategy] ** 2)))
    print(f"{STRATEGIES[strategy]:22s}{1e3 * rms[strategy]:8.1f} µm RMS")

# %% [5] A corner, and the error along the path
figure = Figure(figsize=(9, 4), layout="constrained")
corner, along = figure.subplots(1, 2)
corner.plot(*path.T, color="0.8", lw=5, label="path")
for strategy, label in STRATEGIES.items():
    corner.plot(*nozzle[strategy].T, lw=1, label=label)
    along.plot(np.arange(len(path)) * TS, 1e3 * error[strategy], lw=1, label=label)
corner.set(xlim=corners[1, 0] + [-3.0, 1.5], ylim=y + np.array([-1.5, 3.0]),
           xlabel="x, mm", ylabel="y, mm", aspect="equal")  # fmt: skip
along.set(xlabel="time, s", ylabel="contour error, µm")
along.legend()
figure.savefig(FOLDER / "corner.svg")

# %% [6] What it asks of the motors: both belts of an H-bot, their speed and acceleration
command = hp.compensate(path, printer, "racking")
belts = command @ np.array(printer.kinematics.matrix).T  # (n, 2): A and B
acceleration = np.diff(belts, 2, axis=0) / TS**2
print(f"belts: at most {np.abs(acceleration).max():.0f} mm/s², "
      f"of {printer.motors.belt_acceleration:g}")  # fmt: skip

# %% [7] No model is right. How much of the gain is left on printers that are not quite this one?
shares = np.array([0.0, 0.02, 0.05, 0.1, 0.2])
stays = {strategy: [] for strategy in STRATEGIES}
for share in shares:
    more = replace(plant.Gxtheta, deviation=plant.Gxtheta.deviation * (1.0 + share))
    other = replace(plant, Gxtheta=more)
    for strategy in STRATEGIES:
        moved = hp.predict(hp.compensate(path, printer, strategy), replace(printer, plant=other))
        stays[strategy].append(float(np.sqrt(np.mean(hp.contour_error(moved, path) ** 2))))
figure = Figure(figsize=(6, 4), layout="constrained")
axis = figure.subplots()
for strategy, label in STRATEGIES.items():
    axis.plot(100.0 * shares, 1e3 * np.array(stays[strategy]), "o-", label=label)
axis.set(xlabel="racking gain off, %", ylabel="contour error, µm RMS", ylim=(0.0, None))
axis.legend()
figure.savefig(FOLDER / "model_error.svg")
print(f"racking gain off by 20 %: {1e3 * stays['racking'][-1]:.1f} µm")
