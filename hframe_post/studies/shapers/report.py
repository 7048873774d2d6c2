"""Reports on input shapers: tables, the section for printer.cfg, and JSON."""

from __future__ import annotations

from typing import Any

from hframe_post.studies.shapers.comparison import ShaperComparison
from hframe_post.studies.shapers.shapers import KLIPPER, Shaping
from hframe_post.writers.stream.print_time import duration


def shapings_as_json(found: list[Shaping], usual: Shaping) -> dict[str, Any]:
    """Return the shapers, the best first, and the choice of Klipper's calibration; µm."""
    return {"shapers": [_as_json(s) for s in found], "klipper_calibration": _as_json(usual)}


def _as_json(shaping: Shaping) -> dict[str, Any]:
    return _axes(shaping) | {"contour_error_rms_um": round(shaping.rms * 1e3, 4)}


def _axes(shaping: Shaping) -> dict[str, Any]:
    return {
        axis: {"type": s.name, "hz": round(s.hz, 2), "damping": round(s.damping, 4)}
        for axis, s in (("x", shaping.x), ("y", shaping.y))
    }


def _placed(shaping: Shaping) -> tuple[str, str]:
    x, y = (f"{axis.hz:.1f} ({axis.damping:.2f})" for axis in (shaping.x, shaping.y))
    return x, y


def shapings_as_text(found: list[Shaping], usual: Shaping) -> str:
    """Return a table, and the section for printer.cfg."""
    lines = [f"{'shaper':12s}{'x, Hz (damping)':>18s}{'y, Hz (damping)':>18s}{'µm RMS':>10s}"]
    lines += [_row(s.x.name, s) for s in found]
    names = "/".join(dict.fromkeys((usual.x.name, usual.y.name)))
    lines += [_row(f"Klipper's calibration: {names}", usual)]
    best = next(s for s in found if s.x.name in KLIPPER)
    return "\n".join([*lines, "", best.config()])


def _row(name: str, s: Shaping) -> str:
    x, y = _placed(s)
    if len(name) > 12:
        return f"{name}\n{'':12s}{x:>18s}{y:>18s}{s.rms * 1e3:10.1f}"
    return f"{name:12s}{x:>18s}{y:>18s}{s.rms * 1e3:10.1f}"


def comparison_as_json(found: list[ShaperComparison]) -> list[dict[str, Any]]:
    """Return the compared prints, the most accurate first; µm and s."""
    return [
        {
            "name": compared.name,
            "contour_error_um": compared.contour.micrometres(),
            "print_time_s": round(compared.seconds, 3),
            **({} if compared.shaping is None else _axes(compared.shaping)),
        }
        for compared in found
    ]


def comparison_as_text(found: list[ShaperComparison]) -> str:
    lines = [
        "",
        f"{'comparison':22s}{'x, Hz (damping)':>17s}{'y, Hz (damping)':>17s}"
        f"{'µm RMS':>9s}{'95 %':>8s}{'peak':>7s}{'time':>13s}",
    ]
    for compared in found:
        um = compared.contour.micrometres()
        axes = ("", "") if compared.shaping is None else _placed(compared.shaping)
        lines.append(
            f"{compared.name:22s}{axes[0]:>17s}{axes[1]:>17s}{um['rms']:9.1f}{um['p95']:8.1f}"
            f"{um['peak']:7.0f}{duration(compared.seconds):>13s}"
        )
    return "\n".join(lines)
