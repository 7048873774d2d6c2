"""A window tried on a path: contour error against belt acceleration; and the path of the paper.

A trial's commands are judged on the printer's plant and on random printers that differ a little.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from statistics import median

from hframe_post.compensation.guard import Guard, check_deviation, check_model
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain, Stages
from hframe_post.errors import HframeError
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.error_meter import ErrorMeter
from hframe_post.prediction.statistics import ContourErrors
from hframe_post.printer.settings import Motors, Printer, Travel

ROUGHLY = 1.1  # costs this close to the least are as good; the gentlest of them is taken
RACKING = Options("racking", clamp=False)
ANYWHERE = Travel((-math.inf, math.inf), (-math.inf, math.inf))


@dataclass
class Trial:
    """Windows of x and y, and how they did.

    refused: why they cannot be used at all. contour: on the model, with its range if the model says
    how well it is known and no printers are drawn. drawn: errors on random printers. velocity,
    acceleration: of the belts, mm/s and mm/s².
    """

    windows: tuple[Window, Window]
    refused: str = ""
    contour: ContourErrors = field(default_factory=ContourErrors)
    drawn: list[ContourErrors] = field(default_factory=list)
    velocity: float = 0.0
    acceleration: float = 0.0

    @property
    def cost(self) -> float:
        """Return the error by which windows are compared, mm RMS: the mean of that of the model,
        which the printer may be today, and of the median of printers that differ from it."""
        robust = median(each.expected for each in self.drawn or [self.contour])
        return (self.contour.rms + robust) / 2.0

    def within(self, motors: Motors) -> bool:
        return (
            not self.refused
            and self.velocity <= motors.belt_velocity
            and self.acceleration <= motors.belt_acceleration
        )


def tried(
    lines: Iterable[bytes], printer: Printer, windows: tuple[Window, Window], drawn: list[Plant]
) -> Trial:
    """Return how a printer prints a short file with these windows. Raises HframeError.

    drawn: random printers, which are judged, too.
    """
    plant, trial = printer.plant, Trial(windows)
    check_model(plant, printer.limits)
    chain, guard = Chain(printer, RACKING), Guard(ANYWHERE, Motors(), printer.kinematics)
    path = chain.sampled(chain.planned(lines))  # the same with all windows
    try:
        stages = Stages(Chain(printer.with_windows(windows), RACKING))
        commands = stages.compensated(path)
        commands = check_deviation(commands, "racking", plant, printer.limits)
        chunks = list(guard.check(commands, "racking"))
    except HframeError as error:
        trial.refused = str(error)
        return trial
    trial.velocity, trial.acceleration = guard.peaks.belt_velocity, guard.peaks.belt_acceleration
    doubts = None if drawn else Doubts.from_plant(plant)
    meters = [ErrorMeter(plant, doubts=doubts), *map(ErrorMeter, drawn)]
    for meter in meters:
        for _ in meter.samples(chunks):
            pass
    # without errors if nothing moves
    errors = (meter.contour.get("racking", ContourErrors()) for meter in meters)
    trial.contour, *trial.drawn = errors
    return trial


def recommended(trials: list[Trial], motors: Motors) -> Trial | None:
    """Return the gentlest trial that is about as good as the best the motors can follow.

    Effort matters little on a wrong model. That alone would recommend one that leaves several times
    the error on an exact model.
    """
    able = [trial for trial in trials if trial.within(motors)]
    if not able:
        return None
    least = min(trial.cost for trial in able)
    good = [trial for trial in able if trial.cost <= ROUGHLY * least]
    return min(good, key=lambda trial: trial.acceleration)


def rectangle(printer: Printer) -> list[bytes]:
    """Return the paper's Fig. 7: 120 × 20 mm at 150 mm/s and 1e4 mm/s², at rest at the corners.

    It begins where racking does not move the nozzle, as in the paper, unless the bed is too
    narrow for that, and is centred on the bed in y.
    """
    low, high = printer.travel.x
    width, clear = 120, 5  # mm; the command needs some travel beyond its path
    x = max(min(printer.plant.x_c, high - width - clear), low + clear)
    y = round(sum(printer.travel.y) / 2.0) - 10
    corners = ((x + width, y), (x + width, y + 20), (x, y + 20), (x, y))
    lines = ["G28", "M83", "M204 S10000", "M205 X0 Y0 J0"]  # Marlin with either kind of corners
    lines += ["SET_VELOCITY_LIMIT SQUARE_CORNER_VELOCITY=0"]  # Klipper
    lines += ["G1 Z0.2 F600", f"G0 X{x:g} Y{y:g} F9000", ";LAYER:0", ";TYPE:WALL-OUTER"]
    lines += [
        f"G1 X{x:g} Y{y:g} E{length:g}"
        for (x, y), length in zip(corners, (4, 0.7, 4, 0.7), strict=True)
    ]
    return [line.encode() + b"\n" for line in lines]
