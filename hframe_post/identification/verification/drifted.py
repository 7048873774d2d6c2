"""Whether the model has moved, by the plain motion of a verification and the compensated one.

The model is moved to the plain motion, as by `check`. An axis has drifted if that foresees
the compensated motion, which was not fitted, clearly better. The profile stays as it is: a print
moves in strokes, and on a printer that is not linear a model of this motion can make others worse.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification.checking.drift import drift
from hframe_post.identification.checking.report import Drift
from hframe_post.identification.checking.run import Recorded
from hframe_post.identification.identified import AXIS
from hframe_post.identification.recordings.alignment import acceleration
from hframe_post.identification.responses.frequency_response import whole_record
from hframe_post.identification.verification.motion import QUIET
from hframe_post.identification.verification.pairing import Run
from hframe_post.identification.verification.verdict import MeasuredRun, measured_run
from hframe_post.printer.settings import Printer
from hframe_post.stream.running import one_blas_thread

NEAR = 25.0  # mm
GAINED = 0.97  # of what the old model leaves, that the new one leaves at most


@one_blas_thread()
def drifted(printer: Printer, plain: Run, compensated: Run) -> dict[str, Drift]:
    """Return the axes whose model has moved, by Gxx and Gyy.

    Modes may move along x, so only a motion near its middle tells, where the model holds.
    """
    middle = sum(printer.travel.x) / 2.0
    if abs(float(plain[0][:, X].mean()) - middle) > NEAR:
        return {}
    seen, unseen = (measured_run(printer, *run) for run in (plain, compensated))
    found = {}
    for axis, name, G in ((X, "Gxx", printer.plant.Gxx), (Y, "Gyy", printer.plant.Gyy)):
        u, a = acceleration(plain[0][:, axis]), _along(seen, axis)
        response = whole_record(u, a, float(np.std(a[200 : QUIET - 200])))
        judging = acceleration(compensated[0][:, axis]), _along(unseen, axis)
        try:
            one = drift(G, Recorded(response, judging))
        except IdentificationError:  # farther than printers drift
            continue
        if one.certain and one.left[1] < GAINED * one.left[0]:
            found[name] = one
    return found


def as_text(found: Mapping[str, Drift]) -> str:
    """Return what has moved, and how much of the compensated motion is not foreseen."""
    if not found:
        return "drift       none: no moved model foresees this motion better"
    lines = [f"drift       {AXIS[name]} {one.peak.as_text()}" for name, one in found.items()]
    for name, one in found.items():
        old, new = (f"{100 * left:.0f} %" for left in one.left)
        lines.append(f"drift       unexplained in {AXIS[name]}, compensated: {old} → {new}")
    return "\n".join([*lines, "            to correct the profile: hframe-post check"])


def _along(run: MeasuredRun, axis: int) -> Array:
    """Return the measured acceleration (m,) along an axis without couplings, mm/s²."""
    return np.asarray(run.a[:, axis] - run.a_racking[:, axis] - run.a_cross[:, axis])
