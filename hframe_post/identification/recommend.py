"""Window and λ recommended for an identified plant, and their predicted effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

from hframe_post.conversion.pipeline import Options
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.model.strategies import STRATEGIES
from hframe_post.printer.settings import Printer
from hframe_post.stream.running import one_blas_thread
from hframe_post.studies.inputs import rectangle
from hframe_post.studies.simulation.simulate import SimulationReport, Study, simulate
from hframe_post.studies.simulation.uncertainty import draws
from hframe_post.studies.tuning.tune import candidates, recommended, tune

RANDOM = 10  # printers around the model
SPARED = 0.6  # of the belts' acceleration: short moves of a print need more than a rectangle


@dataclass(frozen=True, slots=True)
class Recommendation:
    """The windows of x and y for an identified plant, and their predicted effect.

    model_error: share by which random printers differ from the plant. rms_of_random, rms_of_others:
    contour error in µm RMS of these printers, and of other plants that were measured, too.
    """

    windows: tuple[Window, Window]
    predicted: SimulationReport
    model_error: float
    rms_of_random: list[float]
    rms_of_others: list[float]

    def rms(self, strategy: str) -> float:
        """Return the predicted contour error of the rectangle, µm."""
        return 1e3 * self.predicted.parts.whole[strategy].contour.rms

    def as_json(self) -> dict[str, Any]:
        x, y = self.windows
        return {
            "windows": {"L": x.L, "n_C": x.n_C, "n_up": x.n_up, "effort": [x.effort, y.effort]},
            "predicted": self.predicted.as_json()["contour_error_um"],
            "predicted_under_model_error": {
                "median_um": round(median(self.rms_of_random), 4),
                "worst_um": round(max(self.rms_of_random), 4),
            },
        }

    def gain(self) -> str:
        errors = ", ".join(f"{name} {self.rms(name):.1f}" for name in self.predicted.strategies)
        return f"contour error of a 120 × 20 mm rectangle, µm RMS: {errors}"

    def rows(self) -> list[tuple[str, str]]:
        x, y = self.windows
        effort = f"effort = [{x.effort:g}, {y.effort:g}]"
        return [
            ("windows", f"L = {x.L}, n_C = {x.n_C}, n_up = {x.n_up}, {effort}"),
            ("predicted", self.gain()),
            (
                "",
                f"on printers within ±{100.0 * self.model_error:.1f} % of the model: median "
                f"{median(self.rms_of_random):.1f}, worst {max(self.rms_of_random):.1f}",
            ),
        ]


@one_blas_thread()
def recommend(
    plant: Plant, profile: Printer, model_error: float, others: Sequence[Plant] = ()
) -> Recommendation | None:
    """Return the best windows for ``plant`` on the machine of ``profile``.

    model_error: share by which the printer may differ from the plant; the windows are judged on ten
    random printers that differ by as much, and on ``others``. None if the motors can
    follow no window, or if one of these printers would be worse off than without compensation.
    """
    updated = replace(profile, plant=plant, name="the identified printer")
    printers = [*draws(plant, model_error, RANDOM, seed=0), *others]
    trials = tune(rectangle(updated), updated, candidates(updated.compensation), printers)
    limit = replace(updated.motors, belt_acceleration=SPARED * updated.motors.belt_acceleration)
    best = recommended(trials, limit) or recommended(trials, updated.motors)
    if best is None:
        return None
    x, y = best.windows
    chosen = replace(
        updated.compensation, L=x.L, n_C=x.n_C, n_up=x.n_up, effort=(x.effort, y.effort)
    )
    updated = replace(updated, compensation=chosen)
    options = Options("racking", tuple(STRATEGIES), clamp=True)
    study = Study(plant, {model_error: printers}, name=updated.name)
    predicted = simulate(rectangle(updated), updated, options, study)
    (similar,) = predicted.model_error
    if similar.better("racking", "none") < len(printers):
        return None
    rms = [1e3 * error for error in similar.rms("racking")]
    known = replace(predicted, model_error=())
    return Recommendation(best.windows, known, model_error, rms[:RANDOM], rms[RANDOM:])
