"""What is told of input shapers: a table, the section for printer.cfg, and JSON."""

from __future__ import annotations

from typing import Any

from hframe_post.studies.shaping import KLIPPER, Shaping


def shapings_as_json(found: list[Shaping], usual: Shaping) -> dict[str, Any]:
    """The best first, and what Klipper's own calibration would leave; µm."""
    return {"shapers": [_as_json(s) for s in found], "klipper_calibration": _as_json(usual)}


def _as_json(shaping: Shaping) -> dict[str, Any]:
    axes = {
        axis: {"type": s.name, "hz": round(s.hz, 2), "damping": round(s.damping, 4)}
        for axis, s in (("x", shaping.x), ("y", shaping.y))
    }
    return axes | {"contour_error_rms_um": round(shaping.rms * 1e3, 4)}


def shapings_as_text(found: list[Shaping], usual: Shaping) -> str:
    """A table, and what to write into printer.cfg."""
    lines = [f"{'shaper':12s}{'x, Hz (damping)':>18s}{'y, Hz (damping)':>18s}{'µm RMS':>10s}"]
    lines += [_row(s.x.name, s) for s in found]
    names = "/".join(dict.fromkeys((usual.x.name, usual.y.name)))
    lines += [_row(f"as Klipper's calibration would set it: {names}", usual)]
    best = next(s for s in found if s.x.name in KLIPPER)
    return "\n".join([*lines, "", best.config()])


def _row(name: str, s: Shaping) -> str:
    x, y = (f"{axis.hz:.1f} ({axis.damping:.2f})" for axis in (s.x, s.y))
    if len(name) > 12:
        return f"{name}\n{'':12s}{x:>18s}{y:>18s}{s.rms * 1e3:10.1f}"
    return f"{name:12s}{x:>18s}{y:>18s}{s.rms * 1e3:10.1f}"
