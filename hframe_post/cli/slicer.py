"""What PrusaSlicer and OrcaSlicer tell a post-processing program, in variables SLIC3R_*."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from hframe_post.errors import one_line
from hframe_post.printer.settings import Limits

OUTPUT_NAME = "SLIC3R_PP_OUTPUT_NAME"  # the slicer's name for the file that is now a temporary one


def output_as_text(environ: Mapping[str, str]) -> list[str]:
    """Return a line for the summary with the slicer's name for the file, if it gives one."""
    name = environ.get(OUTPUT_NAME)
    return [f"file        {one_line(name)}"] if name else []


def shown_name(environ: Mapping[str, str], source: Path) -> str:
    """Return the file's name as the user knows it."""
    return one_line(Path(environ.get(OUTPUT_NAME) or source).name)


def warnings(environ: Mapping[str, str], limits: Limits) -> list[str]:
    """Return a warning if the slicer's accelerations exceed the profile's."""
    excessive = {
        name: value for name, value in _accelerations(environ).items()
        if value > limits.acceleration
    }  # fmt: skip
    if not excessive:
        return []
    settings = ", ".join(f"{name} {value:g}" for name, value in sorted(excessive.items()))
    return [
        f"SLICER      asks for more acceleration than the profile's {limits.acceleration:g} mm/s² "
        f"({settings}): the profile's is used"
    ]


def _accelerations(environ: Mapping[str, str]) -> dict[str, float]:
    """Return mm/s² by setting; without zeros, which leave the choice to the firmware."""
    found = {}
    for variable, text in environ.items():
        name = variable.removeprefix("SLIC3R_")
        machine_limit = name.startswith("MACHINE_")
        if name == variable or machine_limit or not name.endswith("_ACCELERATION"):
            continue
        values = [_number(part) for part in text.split(",")]  # one per extruder
        if 0.0 < max(values) < math.inf:
            found[name.lower()] = max(values)
    return found


def _number(text: str) -> float:
    """Return the number; 0 for a percentage of another setting, and for any other text."""
    try:
        return float(text)
    except ValueError:
        return 0.0
