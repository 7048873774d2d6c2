"""Slow motion and long pauses: left out of the samples, and played as if they were not."""

from __future__ import annotations

import pytest

import hframe_post as hp
from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain, Stages
from hframe_post.planner import sampling
from hframe_post.planner.lookahead import plan
from hframe_post.printer import profile
from hframe_post.writers.print_time import DeferredLine

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


def converted(strategy: str) -> bytes:
    output = GcodeConversion(iter(PRINT), profile.load("paper"), Options(strategy))
    return b"".join(o.line + b"\n" if isinstance(o, DeferredLine) else o for o in output)


def both(strategy: str, monkeypatch: pytest.MonkeyPatch) -> tuple[bytes, bytes]:
    """Return the stream as it is written, and from samples of all motion."""
    short = converted(strategy)
    monkeypatch.setattr(sampling, "FEWEST", 1 << 60)
    return short, converted(strategy)


@pytest.mark.parametrize("strategy", ["racking", "none"])
def test_slow_motion_is_written_as_if_every_sample_of_it_had_been_computed(
    strategy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Within 10 ms: at 20 mm/min the last digit of a place is 3 ms."""
    short, computed = both(strategy, monkeypatch)
    hp.testing.assert_same_motion(short, computed, tolerance=0.02, slack=0.01)
    assert short != computed


@pytest.mark.parametrize("feed", [1, 10, 100])
def test_samples_do_not_grow_with_the_time_that_slow_lines_take(feed: int) -> None:
    lines = [b"G28\n", b"G0 X50 Y50 Z0.3 F6000\n", b"M83\n", b"G1 X60 F6000\n"]
    lines += [b"G1 X%d E1 F%d\n" % (100 - 40 * (k % 2), feed) for k in range(10)]
    lines += [b"G4 P%d\n" % (1_000_000 / feed), b"G1 E-9 F%d\n" % feed, b"G1 Z9.3 F%d\n" % feed]
    printer, options = profile.load("paper"), Options("racking")
    chain = Chain(printer, options)
    stages = Stages(chain, chain.compensator, skip_slow=True)
    planned = plan(chain.parsed(lines), printer.limits)
    chunks = list(stages.predicted(stages.commands(planned), threads=False))
    seconds = (10 * 40 + 9 + 9) * 60 / feed + 1000 / feed
    assert stages.ledger.duration == pytest.approx(seconds, abs=2.0), "s"
    assert sum(map(len, chunks)) < 60_000
