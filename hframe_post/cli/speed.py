"""Options by which ``convert`` spends accuracy on speed, and what they stand for."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from hframe_post.cli.options import share

if TYPE_CHECKING:
    from hframe_post.printer.settings import Printer, Speed
    from hframe_post.studies.speed.search import Fastest

UNITS = {"um": 1e-3, "µm": 1e-3, "mm": 1.0}
_BOUND = re.compile(r"(?:([a-z-]+)=)?(\d+(?:\.\d+)?|\.\d+)\s*(um|µm|mm)")

F = TypeVar("F", bound=Callable[..., Any])


def bounds(text: str) -> dict[str, float]:
    """``30um`` or ``outer-wall=15um,infill=80um``: mm by kind, all others under no name."""
    from hframe_post.stream.features import KINDS

    found: dict[str, float] = {}
    if text == "off":
        return found
    for part in text.split(","):
        match = _BOUND.fullmatch(part.strip())
        if match is None:
            raise click.BadParameter(f"{part!r} is not such as 30um or outer-wall=15um")
        name = match[1] or ""
        if name and name not in KINDS:
            raise click.BadParameter(f"no feature is called {name!r}; there are {', '.join(KINDS)}")
        found[name] = float(match[2]) * UNITS[match[3]]
        if not 1e-4 <= found[name] <= 10.0:
            raise click.BadParameter(f"{part!r} is not between 0.1um and 10mm")
    return found


def factor(text: str) -> float:
    """A number from 1, or ``max``."""
    from hframe_post.studies.speed.search import MOST_SPEED_UP

    try:
        value = MOST_SPEED_UP if text == "max" else float(text)
    except ValueError:
        value = 0.0
    if not 1.0 <= value <= MOST_SPEED_UP:
        raise click.BadParameter(f"{text!r} is neither 'max' nor from 1 to {MOST_SPEED_UP:g}")
    return value


def speed_options(command: F) -> F:
    """The options, from the last to the first as decorators stand."""
    for option in reversed(
        (
            click.option(
                "--max-error", type=bounds, metavar="ERROR",
                help="Print as fast as this contour error allows where filament is laid, such as "
                "30um or outer-wall=15um,infill=80um; 'off': as fast as the file. Default: "
                "speed.max_error of the profile, else off.",
            ),
            click.option(
                "--error-measure", type=click.Choice(["p95", "rms", "peak"]),
                help="What of the error must stay within --max-error. Default: the profile's, "
                "else p95.",
            ),
            click.option(
                "--speed-up", type=factor, metavar="N|max",
                help="With --max-error: times the file's feed rates, at most. The hot end "
                "(limits.flow) and limits.min_layer_time bound it, too. Default: the profile's, "
                "else 1.",
            ),
            click.option(
                "--model-error", type=share, metavar="PERCENT",
                help="With --max-error: by how much the printer may differ from its model while "
                "the error must still hold. Default: the profile's, or the plant's uncertainty "
                "if that is more, else 5%.",
            ),
        )
    ):  # fmt: skip
        command = option(command)
    return command


def asked(
    printer: Printer, source: Path, max_error: dict[str, float] | None, measure: str | None,
    speed_up: float | None, model_error: float | None,
) -> Speed | None:  # fmt: skip
    """What is asked for by options and, where they say nothing, by the profile; None: nothing.

    Raises UsageError.
    """
    options: dict[str, Any] = {
        "max_error": max_error, "error_measure": measure, "speed_up": speed_up,
        "model_error": model_error,
    }  # fmt: skip
    given = {name: value for name, value in options.items() if value is not None}
    chosen = replace(printer.known_speed, **given)
    if not chosen.max_error:
        if given.keys() - {"max_error"}:
            names = ", ".join("--" + name.replace("_", "-") for name in given)
            raise click.UsageError(f"{names} without --max-error")
        return None
    if str(source) == "-":
        raise click.UsageError(
            "--max-error (or speed.max_error of the profile) reads the file several times: name "
            "one, or say --max-error off"
        )
    return chosen


def told(found: Fastest | None) -> Iterable[str]:
    """What the summary says of it."""
    from hframe_post.studies.speed.report import speed_as_text

    return [] if found is None else [speed_as_text(found)]


def told_as_json(found: Fastest | None) -> dict[str, Any]:
    """What the JSON summary says of it."""
    from hframe_post.studies.speed.report import speed_as_json

    return {} if found is None else {"speed": speed_as_json(found)}
