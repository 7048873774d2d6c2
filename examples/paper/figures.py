"""The paper's figures 4, 5, 8, 9 and 11, drawn from what `results.py` computes.

    python -m examples.paper.figures FOLDER [PRISM.GCODE]

The prism, for Fig. 11, is `sample_gcode/prism.gcode`. It takes a minute, and needs matplotlib:
``pip install matplotlib``. The equations and figures are those of arXiv 2105.09878.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

import hframe_post as hp
from examples.paper import results

STYLES = {  # of strategies: label and colour
    "none": ("no compensation", "#888888"),
    "fbs": ("ringing only (fbs)", "#c05020"),
    "racking": ("ringing and racking", "#2060a0"),
}
BLUE = STYLES["racking"][1]
LINE, PIECE = 0.45, 0.4  # mm: width of the line as sliced, and of nozzle's way that filament fills
CORNER = (114.4, 122.4), (-1.0, 4.6)  # mm of x and y
FOLDER = Path(sys.argv[1] if len(sys.argv) > 1 else "figures")
FOLDER.mkdir(parents=True, exist_ok=True)
# equal drawings give equal files
matplotlib.rcParams.update(
    {"font.size": 9.0, "axes.grid": True, "grid.alpha": 0.3, "svg.hashsalt": "hframe-post",
     "svg.fonttype": "none", "path.simplify_threshold": 0.5}
)  # fmt: skip


def canvas(rows, columns, width, height):
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def save(figure, name):
    figure.savefig(FOLDER / f"{name}.svg", metadata={"Date": None, "Creator": None})


def bode(axes, hz, response, unit, title):
    axes[0].semilogx(hz, 20.0 * np.log10(np.abs(response)), color=BLUE)
    axes[0].set(ylabel=f"magnitude, dB ({unit})", title=title)
    axes[1].semilogx(hz, np.degrees(np.unwrap(np.angle(response))), color=BLUE)
    axes[1].set(ylabel="phase, °", xlabel="frequency, Hz")


def along(points):
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def printed(path, nozzle, colour):
    """Return the line that a nozzle lays near the corner. Filament comes out with the path."""
    p, s = along(path), along(nozzle)
    at = np.arange(0.0, s[-1], 0.1)
    middle, before, after = (
        np.column_stack([np.interp(place, s, each) for each in (*nozzle.T, p)])
        for place in (at, at - PIECE / 2.0, at + PIECE / 2.0)
    )
    x, y, filled = (after - before).T / PIECE
    side = 0.5 * LINE * (filled / np.hypot(x, y))[:, None] * np.column_stack([-y, x])
    left, right = middle[:, :2] + side, middle[:, :2] - side
    pieces = np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)
    (low_x, high_x), (low_y, high_y) = CORNER
    low, high = np.array([low_x, low_y]) - 1.0, np.array([high_x, high_y]) + 1.0
    seen = pieces[((pieces > low) & (pieces < high)).all(axis=(1, 2))]
    outlines = [Outline(piece, closed=True) for piece in np.pad(seen, ((0, 0), (0, 1), (0, 0)))]
    return PathPatch(Outline.make_compound_path(*outlines), color=colour, lw=0.2)


printer = hp.load_printer("paper")
plant = printer.plant

# Fig. 4: racking; Fig. 5: the axes
responses = results.frequency_responses(plant, np.geomspace(1.0, 200.0, 400))
figure, axes = canvas(2, 1, 5.0, 4.2)
bode(axes[:, 0], responses.hz, responses.Gxtheta, "rad/m", "$G_{x\\theta}$")
save(figure, "fig04")
figure, axes = canvas(2, 2, 8.0, 4.2)
bode(axes[:, 0], responses.hz, responses.Gxx, "mm/mm", "(a) $G_{xx}$")
bode(axes[:, 1], responses.hz, responses.Gyy, "mm/mm", "(b) $G_{yy}$")
save(figure, "fig05")

# Fig. 8: contour error and time, decoupled and coupled
xy = results.path(printer)
rows = results.approximations(printer, xy)
share = [row.share for row in rows]
figure, axes = canvas(1, 2, 8.0, 3.2)
for k, (name, style) in enumerate((("decoupled", "-o"), ("coupled", "--s"))):
    axes[0, 0].semilogy(share, [row.rms[k] * 1e3 for row in rows], style, label=name)
    axes[0, 1].plot(share, [row.seconds[k] for row in rows], style, label=name)
axes[0, 0].set(xlabel="n / E", ylabel="RMS contour error, µm", title="(a)")
axes[0, 1].set(xlabel="n / E", ylabel="time, s", title="(b)")
axes[0, 0].legend()
save(figure, "fig08")

# Fig. 9: the nozzle at the first corner, and contour error along the path
controls = results.time_responses(printer, xy)
figure, axes = canvas(1, 2, 9.0, 3.4)
for control in controls:
    (label, colour), nozzle = STYLES[control.name], control.nozzle - control.nozzle[0]
    axes[0, 0].plot(*nozzle.T, color=colour, lw=1.0, label=label)
    axes[0, 1].plot(control.along, control.error * 1e3, color=colour, lw=1.0)
axes[0, 0].set(xlim=(112, 122), ylim=(-1.5, 6), xlabel="x, mm", ylabel="y, mm")
axes[0, 0].set_title("(a) first corner, n = 125")
axes[0, 0].legend(loc="upper left")
axes[0, 1].set(xlabel="along the path, mm", ylabel="contour error, µm", title="(b)")
save(figure, "fig09")
# the line as it is printed at that corner, over the line as it was sliced
figure, axes = canvas(1, 3, 7.6, 2.6)
for axis, control in zip(axes[0], controls, strict=True):
    (label, colour), path = STYLES[control.name], xy - xy[0]
    axis.add_patch(printed(path, path, "#e0dccf"))
    axis.add_patch(printed(path, control.nozzle - control.nozzle[0], colour))
    axis.set(xlim=CORNER[0], ylim=CORNER[1], aspect="equal", xlabel="x, mm")
    axis.set_title(f"{label}: {control.rms * 1e3:.0f} µm RMS", loc="left", fontsize=8.5)
    axis.grid(visible=False)
axes[0, 0].set_ylabel("y, mm")
save(figure, "corner")

# Fig. 11: |Δw| as boxes (median in the box), its RMS as a diamond
if len(sys.argv) > 2:
    slice_ = Path(sys.argv[2]).read_bytes().splitlines(keepends=True)
    figure, axes = canvas(1, 2, 9.0, 3.4)
    for axis, printed_window in zip(axes[0], (False, True), strict=True):
        prism = results.widths(printer, slice_, printed_window)
        boxes = [np.abs(error).ravel() * 1e3 for error in prism.error.values()]
        axis.boxplot(boxes, tick_labels=[STYLES[name][0] for name in prism.error])
        rms = [prism.rms(name) * 1e3 for name in prism.error]
        axis.plot(range(1, len(rms) + 1), rms, "D", color=BLUE, label="RMS")
        axis.set(ylabel="|Δw|, µm", title=f"{prism.window} window")
        axis.tick_params(axis="x", labelsize=7)
        axis.legend()
    save(figure, "fig11")
