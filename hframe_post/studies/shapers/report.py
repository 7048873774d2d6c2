"""What is told of input shapers: a table, the section for printer.cfg, and JSON."""

from __future__ import annotations

from typing import Any

from hframe_post.studies.shapers.rivals import Rival
from hframe_post.studies.shapers.shapers import KLIPPER, Shaping
from hframe_post.writers.stream.print_time import duration


def shapings_as_json(found: list[Shaping], usual: Shaping) -> dict[str, Any]:
    """The best first, and what Klipper's own calibration would leave; µm."""
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
    """A table, and what to write into printer.cfg."""
    lines = [f"{'shaper':12s}{'x, Hz (damping)':>18s}{'y, Hz (damping)':>18s}{'µm RMS':>10s}"]
    lines += [_row(s.x.name, s) for s in found]
    names = "/".join(dict.fromkeys((usual.x.name, usual.y.name)))
    lines += [_row(f"as Klipper's calibration would set it: {names}", usual)]
    best = next(s for s in found if s.x.name in KLIPPER)
    return "\n".join([*lines, "", best.config()])


def _row(name: str, s: Shaping) -> str:
    x, y = _placed(s)
    if len(name) > 12:
        return f"{name}\n{'':12s}{x:>18s}{y:>18s}{s.rms * 1e3:10.1f}"
    return f"{name:12s}{x:>18s}{y:>18s}{s.rms * 1e3:10.1f}"


def rivals_as_json(found: list[Rival]) -> list[dict[str, Any]]:
    """The most accurate first; µm and s."""
    return [
        {
            "name": rival.name,
            "contour_error_um": rival.contour.micrometres(),
            "print_time_s": round(rival.seconds, 3),
            **({} if rival.shaping is None else _axes(rival.shaping)),
        }
        for rival in found
    ]


def rivals_as_text(found: list[Rival]) -> str:
    """A table."""
    lines = [
        "",
        f"{'against shapers':22s}{'x, Hz (damping)':>17s}{'y, Hz (damping)':>17s}"
        f"{'µm RMS':>9s}{'95 %':>8s}{'peak':>7s}{'time':>13s}",
    ]
    for rival in found:
        um = rival.contour.micrometres()
        axes = ("", "") if rival.shaping is None else _placed(rival.shaping)
        lines.append(
            f"{rival.name:22s}{axes[0]:>17s}{axes[1]:>17s}{um['rms']:9.1f}{um['p95']:8.1f}"
            f"{um['peak']:7.0f}{duration(rival.seconds):>13s}"
        )
    return "\n".join(lines)
