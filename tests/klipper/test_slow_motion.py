"""Slow motion and long pauses: left out of the samples, and played as if they were not."""

from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain, Stages
from hframe_post.conversion.spans import Beginning
from hframe_post.planner import sampling
from hframe_post.planner.lookahead import plan
from hframe_post.printer import profile
from tests.gcode_tools import converted
from tests.klipper.host import Playback, play

LATE = 12  # ms

PRINT = b"""G28
G1 Z0.3 F600
G0 X100 Y100 F9000
M83
;LAYER:0
;TYPE:WALL-OUTER
G1 X130 Y100 E1.2 F6000
G1 X136 Y103 E0.27 F20
M117 between
G1 X136 Y110 E0.4
G1 X130 Y130 E0.9 F6000
G1 E-0.4 F1
G1 Z1.1 F2
G0 X100 Y130 F9000
G1 Z0.3 F1200
G1 E0.4 F1
G1 X100 Y110 E0.8 F3000
G4 P45000
;LAYER:1
G1 X101 Y100 E0.4 F3000
G4 P30000
G1 X90 Y90 E0.5 F80
M400
G1 X95 Y90 E0.3 F6000
""".splitlines(keepends=True)


def both(monkeypatch: pytest.MonkeyPatch) -> tuple[bytes, bytes]:
    """Return the stream as it is written, and from samples of all motion."""
    short, _ = converted(PRINT, profile.load("paper"))
    monkeypatch.setattr(sampling, "FEWEST", 1 << 60)
    return short, converted(PRINT, profile.load("paper"))[0]


def motion(run: Playback, seconds: float) -> Array:
    """Return x, y, z, e (n, 4) every millisecond from the end of the first lift on."""
    t = float(run.moves["print_time"][1]) + np.arange(0.0, seconds, 1e-3)
    return np.column_stack([run.position(t), run.extruded(t)])


def test_slow_motion_is_written_as_any(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Within 10 ms: at 20 mm/min the last digit of a place is 3 ms."""
    short, computed = (tmp_path / name for name in ("short.gcode", "computed.gcode"))
    texts = both(monkeypatch)
    assert texts[0] != texts[1]
    for file, text in zip((short, computed), texts, strict=True):
        file.write_bytes(text)
    runs = [play(file, workdir=tmp_path / file.stem) for file in (short, computed)]
    seconds = [float(run.moves["print_time"][-1] - run.moves["print_time"][1]) for run in runs]
    assert seconds[0] == pytest.approx(seconds[1], abs=0.01)
    here, there = (motion(run, min(seconds)) for run in runs)
    inner = here[LATE:-LATE]
    apart = np.full(len(inner), np.inf)
    for first in range(2 * LATE + 1):
        off = inner - there[first : first + len(inner)]
        apart = np.minimum(apart, np.sqrt(np.square(off).sum(axis=1)))
    assert apart.max() < 0.08, "mm; at 100 mm/s samples are 0.1 mm apart"


@pytest.mark.parametrize("feed", [1, 10, 100])
def test_samples_do_not_grow_with_the_time_that_slow_lines_take(feed: int) -> None:
    lines = [b"G28\n", b"G0 X50 Y50 Z0.3 F6000\n", b"M83\n", b"G1 X60 F6000\n"]
    lines += [b"G1 X%d E1 F%d\n" % (100 - 40 * (k % 2), feed) for k in range(10)]
    lines += [b"G4 P%d\n" % (1_000_000 / feed), b"G1 E-9 F%d\n" % feed, b"G1 Z9.3 F%d\n" % feed]
    printer, options = profile.load("paper"), Options("racking")
    chain = Chain(printer, options)
    stages = Stages(chain, beginning=Beginning())
    planned = plan(chain.read(lines), printer.limits)
    chunks = list(stages.predicted(stages.commands(planned)))
    seconds = (10 * 40 + 9 + 9) * 60 / feed + 1000 / feed
    assert stages.ledger.duration == pytest.approx(seconds, abs=2.0), "s"
    assert sum(map(len, chunks)) < 60_000
