"""Canvas and style of figures, PNG and SVG: the one door to matplotlib."""

from __future__ import annotations

from typing import IO, TYPE_CHECKING, Any

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import HframeError, install_advice

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 110
STYLE = {
    "font.size": 9.0,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "svg.hashsalt": "hframe-post",  # equal drawings give equal files
    "svg.fonttype": "none",
    "path.simplify_threshold": 0.5,
}


def save(figure: Figure, file: IO[bytes], kind: str) -> None:
    """Write a ``png`` or ``svg`` without metadata that changes from run to run."""
    volatile = ("Date", "Creator") if kind == "svg" else ("Software",)
    figure.savefig(file, format=kind, dpi=DPI, metadata=dict.fromkeys(volatile))


def canvas(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, Any]:
    """Return a figure with its axes. Raises HframeError if matplotlib is missing."""
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError:
        raise HframeError(
            f"drawing needs matplotlib. Install it with: {install_advice('matplotlib')}"
        ) from None
    style: Any = matplotlib.rcParams
    style.update(STYLE)
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def decibel(H: Complex) -> Array:
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(H), 1e-12)))


def degrees(H: Complex) -> Array:
    """Return the unwrapped phase of ``H`` in degrees."""
    return np.degrees(np.unwrap(np.angle(H)))
