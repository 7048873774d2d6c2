"""Window and λ recommended for an identified plant, and their predicted effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import cos, sin, tau
from typing import Any

from hframe_post.conversion.options import Options
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.model.strategies import STRATEGIES
from hframe_post.native.linear import one_blas_thread
from hframe_post.prediction.doubts import Doubts
from hframe_post.printer.settings import Motors, Printer
from hframe_post.studies.simulation import SimulationReport, Study, simulate
from hframe_post.studies.tuning import Trial, recommended, rectangle, tried

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
        return f"contour error of a 120 × 20 mm rectangle, µm RMS: {errors}{self._up_to()}"

    def _up_to(self) -> str:
        known = self.most > self.rms("racking")
        return f", up to {self.most:.1f} as the printer changes" if known else ""

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
    trials = list[tuple[Trial, Trial]]()
    for effort in MEASURED:
        window = Window(5, 88, 44, effort, printer.compensation.degree)
        own = printer, (window, window)
        at_corners = tried(square(printer), *own, [])
        trials.append((tried(rectangle(printer), *own, printers), at_corners))
        if (found := _recommended(trials, spared)) is not None:
            return found
    able = [trial for trial, _ in trials if trial.within(motors)]
    gentlest = min(able, key=lambda trial: trial.acceleration, default=None)
    return _recommended(trials, motors) or gentlest


def _recommended(trials: Sequence[tuple[Trial, Trial]], motors: Motors) -> Trial | None:
    return recommended([trial for trial, turning in trials if turning.within(motors)], motors)


def square(printer: Printer) -> list[bytes]:
    """Return a square that is passed as fast as the profile allows, turned as it is hardest.

    In its corners one motor alone must change the speed.
    """
    crossed = printer.kinematics.min_speed_ratio < 1.0
    x, y = (sum(ends) / 2.0 for ends in (printer.travel.x, printer.travel.y))
    lines = ["G28", "M83", "G1 Z0.2 F600", f"G0 X{x:g} Y{y:g} F{60.0 * printer.limits.velocity:g}"]
    for k in range(4 * ROUNDS):
        angle = tau * (k + (0.0 if crossed else 0.5)) / 4.0
        x, y = x + SIDE * cos(angle), y + SIDE * sin(angle)
        lines.append(f"G1 X{x:.3f} Y{y:.3f} E0.1")
    return [line.encode() + b"\n" for line in lines]
