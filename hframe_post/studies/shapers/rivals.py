"""A print under each input shaper, beside no compensation and this tool's own.

    plan ──► commands ──► and those of shapers ──► nozzle ──► contour error of each

Each shaper stands twice: with the frequencies and damping that serve the printer best on pieces
from all over the print, and with the frequencies that Klipper's own calibration would choose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from hframe_post.arrays import TS
from hframe_post.conversion.meters import JUDGED_EVERY
from hframe_post.conversion.pipeline import Commands, Options
from hframe_post.model.strategies import STRATEGIES
from hframe_post.prediction.predict import judge
from hframe_post.prediction.statistics import ContourErrors
from hframe_post.printer.settings import Printer
from hframe_post.resources import one_blas_thread
from hframe_post.studies.shapers.shapers import (
    KLIPPER,
    Shaping,
    calibrated_as,
    paths,
    search,
    shape,
)

CALIBRATED = " as calibrated"  # after the name of a shaper that Klipper's calibration places


@dataclass(frozen=True, slots=True)
class Rival:
    """What a print would be. name: of a strategy or a shaper; shaping: None of a strategy's own.

    seconds: of the print; of a shaper with the time that its last motion is longer.
    """

    name: str
    shaping: Shaping | None
    contour: ContourErrors
    seconds: float


@one_blas_thread()
def rivals(lines: Callable[[], Iterable[bytes]], printer: Printer, options: Options) -> list[Rival]:
    """Strategies and shapers on a print, the most accurate first. Raises HframeError.

    lines: gives the print anew at each call.
    """
    searched = search(printer.plant, paths(lines(), printer, options))
    shapings = {found.x.name: found for found in searched}
    shapings |= {name + CALIBRATED: calibrated_as(printer.plant, name) for name in KLIPPER}
    source = Commands(lines(), printer, options, tuple(STRATEGIES))
    contours: dict[str, ContourErrors] = {}
    for judgement in judge(shape(source, shapings), printer.plant, JUDGED_EVERY):
        for name, errors in judgement.contour.items():
            contours.setdefault(name, ContourErrors()).add(errors, judgement.extruding)
    time = source.report().time
    own = {name: time.before if name == "none" else time.after for name in STRATEGIES}
    late = {
        name: time.before + TS * max(s.x.shaper.reach, s.y.shaper.reach)
        for name, s in shapings.items()
    }
    return sorted(
        (
            Rival(name, shapings.get(name), contour, own.get(name, late.get(name, 0.0)))
            for name, contour in contours.items()
        ),
        key=lambda rival: rival.contour.rms,
    )
