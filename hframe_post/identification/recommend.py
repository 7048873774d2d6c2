"""Window and λ for a plant that was found, and what they are predicted to do."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from hframe_post.blas import one_thread
from hframe_post.conversion.pipeline import Options
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.model.strategies import STRATEGIES
from hframe_post.printer.settings import Printer
from hframe_post.studies.reference_path import rectangle
from hframe_post.studies.simulation import Study, simulate
from hframe_post.studies.simulation_report import SimulationReport
from hframe_post.studies.tuning import candidates, recommended, tune
from hframe_post.studies.uncertainty import draws

MODEL_ERROR = 0.05  # of the printers for which the window and λ are chosen
DRAWS = 10


@dataclass(frozen=True, slots=True)
class Recommendation:
    """The windows of x and y for the plant that was found, and what they are predicted to do."""

    windows: tuple[Window, Window]
    predicted: SimulationReport

    def as_json(self) -> dict[str, Any]:
        """Ready for ``json.dumps``."""
        x, y = self.windows
        return {
            "windows": {"L": x.L, "n_C": x.n_C, "n_up": x.n_up, "effort": [x.effort, y.effort]},
            "predicted": self.predicted.as_json()["contour_error_um"],
        }

    def gain(self) -> str:
        """What compensation is predicted to do for the paper's rectangle."""
        whole = self.predicted.parts.whole
        rms = {name: 1e3 * figures.contour.rms for name, figures in whole.items()}
        told = ", ".join(f"{name} {rms[name]:.1f}" for name in self.predicted.strategies)
        return f"predicted   contour error of a 120 × 20 mm rectangle, µm RMS: {told}"

    def as_text(self) -> list[str]:
        """Two lines for a person."""
        x, y = self.windows
        return [
            f"windows     L = {x.L}, n_C = {x.n_C}, n_up = {x.n_up}, "
            f"effort = [{x.effort:g}, {y.effort:g}]",
            self.gain(),
        ]


@one_thread()
def recommend(plant: Plant, profile: Printer) -> Recommendation | None:
    """The best windows for the plant on that machine; None if its motors can follow none."""
    own = replace(profile, plant=plant, name="the printer that was found")
    printers = draws(plant, MODEL_ERROR, DRAWS, seed=0)
    best = recommended(
        tune(rectangle(own), own, candidates(own.compensation), printers), own.motors
    )
    if best is None:
        return None
    x, y = best.windows
    chosen = replace(own.compensation, L=x.L, n_C=x.n_C, n_up=x.n_up, effort=(x.effort, y.effort))
    own = replace(own, compensation=chosen)
    options = Options("racking", tuple(STRATEGIES), clamp=True)
    predicted = simulate(rectangle(own), own, options, Study(plant, name=own.name))
    return Recommendation(best.windows, predicted)
