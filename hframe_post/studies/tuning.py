"""The windows for a printer: each is tried on a path, contour error against belt acceleration.

A trial's commands are judged on the printer's plant and on random printers that differ a little.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Any

from hframe_post.compensation.guard import Guard, check_deviation, check_model
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain, Stages
from hframe_post.errors import HframeError
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.model.strategies import STRATEGIES
from hframe_post.native.linear import one_blas_thread
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.error_meter import ErrorMeter
from hframe_post.prediction.statistics import ContourErrors
from hframe_post.printer.settings import Motors, Printer, Travel
from hframe_post.studies.simulation import SimulationReport, Study, simulate

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


# ---------------------------------------------------------------------- an identified printer

RANDOM = 10  # printers around the model
# λ of measured responses, √λ being how far Q is off in another session, besides a drift of its
# frequencies: 2.8 samples² on published printers within 18 days. Belts that cannot follow get more
MEASURED = (10.0, 100.0, 1000.0)
SPARED = 0.6  # of the belts' acceleration: short moves of a print need more than these motions
SIDE, ROUNDS = 5.0, 3  # mm of a square's side, and how often it is gone round


@dataclass(frozen=True, slots=True)
class Recommendation:
    """The windows of x and y for an identified plant, and their predicted effect."""

    windows: tuple[Window, Window]
    predicted: SimulationReport

    def rms(self, strategy: str) -> float:
        """Return the predicted contour error of the rectangle, µm: the median of its range."""
        return 1e3 * self.predicted.parts.whole[strategy].contour.expected

    @property
    def most(self) -> float:
        """Return the upper end of the range of the compensated error, µm."""
        known = self.predicted.parts.whole["racking"].contour.range
        return 1e3 * known.high if known is not None else self.rms("racking")

    def as_json(self) -> dict[str, Any]:
        x, y = self.windows
        return {
            "windows": {"L": x.L, "n_C": x.n_C, "n_up": x.n_up, "effort": [x.effort, y.effort]},
            "predicted": self.predicted.as_json()["contour_error_um"],
            "predicted_under_model_error": {
                "median_um": round(self.rms("racking"), 4),
                "worst_um": round(self.most, 4),
            },
        }

    def gain(self) -> str:
        errors = ", ".join(f"{name} {self.rms(name):.1f}" for name in self.predicted.strategies)
        known = self.most > self.rms("racking")
        up_to = f", up to {self.most:.1f} as the printer changes" if known else ""
        return f"contour error of a 120 × 20 mm rectangle, µm RMS: {errors}{up_to}"

    def rows(self) -> list[tuple[str, str]]:
        x, y = self.windows
        effort = f"effort = [{x.effort:g}, {y.effort:g}]"
        return [
            ("windows", f"L = {x.L}, n_C = {x.n_C}, n_up = {x.n_up}, {effort}"),
            ("predicted", self.gain()),
        ]


@one_blas_thread()
def recommend(plant: Plant, profile: Printer, model_error: float) -> Recommendation | None:
    """Return the best windows for ``plant`` on the machine of ``profile``.

    Measured responses get the same ones on every printer that can follow, since their solver knows
    how well they are known. model_error: share by which the printer may differ from the plant; the
    windows are judged on ten random printers that differ by as much. None if the motors can follow
    no window, or if one of these printers would be worse off than without compensation.
    """
    updated = replace(profile, plant=plant, name="the identified printer")
    printers = plant.drawn(model_error, RANDOM, seed=0)
    best = _best(updated, printers)
    if best is None:
        return None
    updated = updated.with_windows(best.windows)
    options = Options("racking", tuple(STRATEGIES), clamp=True)
    doubts = Doubts.from_plant(plant, model_error)
    study = Study(plant, {model_error: printers}, name=updated.name, doubts=doubts, exact=True)
    predicted = simulate(lambda: rectangle(updated), updated, options, study)
    (similar,) = predicted.model_error
    if similar.better("racking", "none") < len(printers):
        return None
    return Recommendation(best.windows, replace(predicted, model_error=()))


def _best(printer: Printer, printers: list[Plant]) -> Trial | None:
    """Return the best windows that the motors can follow, in corners at speed, too.

    Where they can follow none of them in corners, the gentlest: a clamp helps there.
    """
    # what nobody stated grows with the file that is converted, and limits no window
    motors = printer.motors.stated
    spared = replace(motors, belt_acceleration=SPARED * motors.belt_acceleration)
    trials, turning = list[Trial](), list[Trial]()
    for effort in MEASURED:
        window = Window(5, 88, 44, effort, printer.compensation.degree)
        trial = tried(rectangle(printer), printer, (window, window), printers)
        at_corners = tried(square(printer), printer, (window, window), [])
        if trial.within(spared) and at_corners.within(spared):
            return trial
        trials.append(trial)
        if at_corners.within(motors):
            turning.append(trial)
    able = [trial for trial in trials if trial.within(motors)]
    gentlest = min(able, key=lambda trial: trial.acceleration, default=None)
    return recommended(turning, motors) or gentlest


def square(printer: Printer) -> list[bytes]:
    """Return a square that is passed as fast as the profile allows, turned as it is hardest.

    In its corners one motor alone must change the speed.
    """
    crossed = printer.kinematics.min_speed_ratio < 1.0
    x, y = (sum(ends) / 2.0 for ends in (printer.travel.x, printer.travel.y))
    lines = ["G28", "M83", "G1 Z0.2 F600", f"G0 X{x:g} Y{y:g} F{60.0 * printer.limits.velocity:g}"]
    for k in range(4 * ROUNDS):
        angle = math.tau * (k + (0.0 if crossed else 0.5)) / 4.0
        x, y = x + SIDE * math.cos(angle), y + SIDE * math.sin(angle)
        lines.append(f"G1 X{x:.3f} Y{y:.3f} E0.1")
    return [line.encode() + b"\n" for line in lines]
