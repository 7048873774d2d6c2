"""What PrusaSlicer and its kin tell a post-processing program: their settings, as SLIC3R_*."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from hframe_post.errors import one_line
from hframe_post.printer.settings import Limits

_PREFIX = "SLIC3R_"
_NO_ACCELERATION = "MACHINE_"  # the printer's own limits ask for nothing


def output(environ: Mapping[str, str]) -> list[str]:
    """The name that the converted file will have, where a slicer runs this; it is another now."""
    name = environ.get("SLIC3R_PP_OUTPUT_NAME")
    return [f"file        {one_line(name)}"] if name else []


def shown_name(environ: Mapping[str, str], source: Path) -> str:
    """What people call the file."""
    return one_line(Path(environ.get("SLIC3R_PP_OUTPUT_NAME") or source).name)


def warnings(environ: Mapping[str, str], limits: Limits) -> list[str]:
    """What the slicer asks of the printer that the profile does not allow."""
    asked = _accelerations(environ).items()
    beyond = {name: value for name, value in asked if value > limits.acceleration}
    if not beyond:
        return []
    settings = ", ".join(f"{name} {value:g}" for name, value in sorted(beyond.items()))
    return [
        f"SLICER      asks for more acceleration than the profile's {limits.acceleration:g} mm/s² "
        f"({settings}): planned with the profile's"
    ]


def _accelerations(environ: Mapping[str, str]) -> dict[str, float]:
    """Setting → mm/s², of those that are above zero (0: the firmware's default)."""
    found = {}
    for variable, text in environ.items():
        name = variable.removeprefix(_PREFIX)
        if name == variable or name.startswith(_NO_ACCELERATION):
            continue
        if not name.endswith("_ACCELERATION"):
            continue
        values = [_number(part) for part in text.split(",")]  # one an extruder
        if 0.0 < max(values) < math.inf:
            found[name.lower()] = max(values)
    return found


def _number(text: str) -> float:
    """A number; 0 for shares of another setting, and what is no number."""
    try:
        return float(text)
    except ValueError:
        return 0.0
