"""Options by which ``convert`` spends accuracy on speed, and what they stand for."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from hframe_post.cli.options import share

if TYPE_CHECKING:
    from hframe_post.conversion.pipeline import Options
    from hframe_post.printer.settings import Printer
    from hframe_post.studies.speed import Bound, Fastest

DRAWS, SEED = 40, 0  # printers that are off by the model error, on which a bound must hold too
UNITS = {"um": 1e-3, "µm": 1e-3, "mm": 1.0}
_BOUND = re.compile(r"(?:([a-z-]+)=)?(\d+(?:\.\d+)?|\.\d+)\s*(um|µm|mm)")

F = TypeVar("F", bound=Callable[..., Any])


def bounds(text: str) -> dict[str, float]:
    """``30um`` or ``outer-wall=15um,infill=80um``: mm by kind, all others under no name."""
    from hframe_post.stream.features import KINDS

    found: dict[str, float] = {}
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
    from hframe_post.studies.speed import MOST_SPEED_UP

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
                "30um or outer-wall=15um,infill=80um.",
            ),
            click.option(
                "--error-measure", type=click.Choice(["p95", "rms", "peak"]), default="p95",
                show_default=True, help="What of the error must stay within --max-error.",
            ),
            click.option(
                "--speed-up", type=factor, metavar="N|max", default="1", show_default=True,
                help="With --max-error: times the file's feed rates, at most. The hot end "
                "(limits.flow) and limits.min_layer_time bound it, too.",
            ),
            click.option(
                "--model-error", type=share, metavar="PERCENT", default="5%", show_default=True,
                help="With --max-error: by how much the printer may differ from its model while "
                "the error must still hold.",
            ),
        )
    ):  # fmt: skip
        command = option(command)
    return command


def hastened(
    source: Path, printer: Printer, options: Options, given: dict[str, float], measure: str,
    speed_up: float, model_error: float,
) -> Fastest:  # fmt: skip
    """How that file is printed in the least time. Raises HframeError."""
    from hframe_post.studies.drive import Freedom
    from hframe_post.studies.speed import fastest
    from hframe_post.studies.uncertainty import draws

    def lines() -> Iterator[bytes]:
        with source.open("rb") as file:
            yield from file

    limits = printer.limits
    drawn = draws(printer.plant, model_error, DRAWS if model_error else 0, SEED)
    freedom = Freedom(speed_up, limits.filament_velocity, limits.min_layer_time)
    return fastest(lines, printer, options, _bound(given, measure), freedom, tuple(drawn))


def _bound(given: dict[str, float], measure: str) -> Bound:
    from hframe_post.studies.speed import Bound

    others = given.get("", max(given.values()))
    kinds = {name: error for name, error in given.items() if name}
    return Bound(others, kinds, measure)  # type: ignore[arg-type]


def told(found: Fastest | None) -> Iterable[str]:
    """What the summary says of it."""
    from hframe_post.studies.speed_report import speed_as_text

    return [] if found is None else [speed_as_text(found)]


def told_as_json(found: Fastest | None) -> dict[str, Any]:
    """What the JSON summary says of it."""
    from hframe_post.studies.speed_report import speed_as_json

    return {} if found is None else {"speed": speed_as_json(found)}
