"""Options of ``convert`` for printing as fast as an error allows."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import click

from hframe_post.cli.options import number
from hframe_post.printer.settings import Printer, Speed
from hframe_post.stream.features import KINDS

MAX_SPEED_UP = 20.0  # times the file's feed rates
UNITS = {"um": 1e-3, "µm": 1e-3, "mm": 1.0}

F = TypeVar("F", bound=Callable[..., Any])


def error_bounds(text: str) -> dict[str, float]:
    """Read ``30um`` or ``outer-wall=15um,infill=80um`` as mm by feature; '' is all others."""
    found: dict[str, float] = {}
    if text == "off":
        return found
    for part in text.split(","):
        match = re.fullmatch(r"(?:([a-z-]+)=)?(\d+(?:\.\d+)?|\.\d+)\s*(um|µm|mm)", part.strip())
        if match is None:
            raise click.BadParameter(f"{part!r} is not an error such as 30um or outer-wall=15um")
        name = match[1] or ""
        if name and name not in KINDS:
            raise click.BadParameter(f"no feature is called {name!r}; there are {', '.join(KINDS)}")
        found[name] = float(match[2]) * UNITS[match[3]]
        if not 1e-4 <= found[name] <= 10.0:
            raise click.BadParameter(f"{part!r} is not between 0.1um and 10mm")
    return found


def speed_factor(text: str) -> float:
    """Read a number from 1, or ``max``."""
    value = MAX_SPEED_UP if text == "max" else number(text)
    if not 1.0 <= value <= MAX_SPEED_UP:
        raise click.BadParameter(f"{text!r} is neither 'max' nor from 1 to {MAX_SPEED_UP:g}")
    return value


def speed_options(command: F) -> F:
    for option in (
        click.option(
            "--speed-up", type=speed_factor, metavar="N|max",
            help="With --max-error: at most N times the file's feed rates; limits.flow and "
            "limits.min_layer_time of the profile hold, too. Default: speed.speed_up of the "
            "profile, or 1.",
        ),
        click.option(
            "--max-error", type=error_bounds, metavar="ERROR",
            help="Print as fast as this contour error allows: 30um, or by feature "
            "outer-wall=15um,infill=80um; 'off' for the file's speeds. The statistic compared with "
            "it is speed.error_measure of the profile. Default: speed.max_error of the profile.",
        ),
    ):  # fmt: skip
        command = option(command)
    return command


def speed_from_options(
    printer: Printer, source: Path, max_error: dict[str, float] | None, speed_up: float | None
) -> Speed:  # fmt: skip
    """Return the profile's speed settings, changed by the options. Raises UsageError."""
    options: dict[str, Any] = {"max_error": max_error, "speed_up": speed_up}
    given = {name: value for name, value in options.items() if value is not None}
    speed = replace(printer.known_speed, **given)
    if not speed.max_error and given.keys() - {"max_error"}:
        names = ", ".join("--" + name.replace("_", "-") for name in given)
        raise click.UsageError(f"{names} needs --max-error")
    if speed.max_error and str(source) == "-":
        raise click.UsageError(
            "--max-error (or speed.max_error of the profile) reads the file several times: name "
            "a file, or use --max-error off"
        )
    return speed
