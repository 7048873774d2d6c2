"""What a print has today, against the trapezoids of Klipper's own host."""

from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import TS
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.firmware.klipper.code import table_of
from hframe_post.prediction.best_shaper import error
from hframe_post.printer.settings import Printer
from tests.conftest import SAMPLES
from tests.klipper.host import play
from tests.quantities import near


@pytest.mark.klipper
def test_errors_as_sliced_are_those_of_klippers_motion(paper: Printer, tmp_path: Path) -> None:
    lines = (SAMPLES / "cube.gcode").read_bytes().splitlines(keepends=True)
    lines = lines[: lines.index(b";LAYER:3\n")]
    (tmp_path / "part.gcode").write_bytes(b"".join(lines))
    table = table_of(paper)
    limits = {
        "max_velocity": table.velocity, "max_accel": table.acceleration,
        "square_corner_velocity": table.square_corner_velocity,
        "minimum_cruise_ratio": table.minimum_cruise_ratio,
    }  # fmt: skip
    host = play(tmp_path / "part.gcode", limits=limits, workdir=tmp_path)
    t = np.arange(host.start, host.end, TS)
    path = np.ascontiguousarray(host.position(t)[:, :2])
    fed = np.diff(host.extruded(t), prepend=0.0) > 0.0
    moving = np.abs(np.diff(path, axis=0, prepend=path[:1])).max(axis=1) > 0.0
    sliced = SlicedFile.from_items(Chain(paper, Options("none")).read(lines), paper)
    today = sliced.today()
    assert today.shaping is not None
    near(sliced.own.seconds, host.duration, 0.01 * host.duration, "print time, s")
    theirs = error(paper.plant, today.shaping, [(path, fed & moving)]).rms
    near(today.contour["shaper"].rms, theirs, 0.05 * theirs, "error with the shaper, mm")
