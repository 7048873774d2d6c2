"""The fastest print within an error: the bound holds, and less error takes more time."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from hframe_post import library
from hframe_post.conversion.options import Options
from hframe_post.conversion.print_report import Report
from hframe_post.errors import HframeError
from hframe_post.printer.settings import Printer
from hframe_post.studies.speed import FASTEST, NEAR, next_factor, worst
from tests.command_line import run
from tests.gcode_tools import sample


def cube() -> list[bytes]:
    """The first and a later layer; extrusion is relative."""
    lines = sample("cube.gcode")
    second, fifth, sixth = (lines.index(b";LAYER:%d\n" % number) for number in (1, 4, 5))
    return [*lines[:second], *lines[fifth:sixth]]


def fast(printer: Printer, error: float) -> Report:
    return library.convert(cube(), None, printer, Options(max_error=error))


@pytest.fixture(scope="module")
def known(paper: Printer) -> Printer:
    return replace(paper, invented=False, uncertainty=0.05)


@pytest.fixture(scope="module")
def tight(known: Printer) -> Report:
    return fast(known, 0.0065)


@pytest.fixture(scope="module")
def loose(known: Printer) -> Report:
    return fast(known, 0.02)


def test_less_error_takes_more_time(loose: Report, tight: Report) -> None:
    assert loose.time.after < tight.time.after
    assert loose.time.before == tight.time.before


def test_the_bound_is_used_up_and_holds_for_the_range_of_the_model(tight: Report) -> None:
    contour = tight.contour["racking"]
    assert NEAR * 0.0065 <= worst(contour, "p95") <= 0.0065
    assert contour.range is not None
    assert contour.shown.percentile(0.95) < worst(contour, "p95")
    (row,) = tight.speed
    found = row.keys["speed"]
    assert found["predicted_um"] == pytest.approx(1e3 * contour.shown.percentile(0.95), abs=1e-3)
    assert "6 permitted" in row.text
    assert found["uncompensated_um"] == tight.contour["none"].shown.micrometres()["p95"]


def test_a_print_that_no_factor_keeps_within_the_bound_is_refused(known: Printer) -> None:
    with pytest.raises(HframeError, match=r"even with 0\.06\d* times its accelerations"):
        fast(known, 1e-4)


@pytest.mark.slow
def test_same_bytes_each_time_and_whatever_the_processes(tmp_path: Path) -> None:
    part = tmp_path / "in.gcode"
    part.write_bytes(b"".join(cube()))
    made = []
    for jobs in (1, 2):
        out = tmp_path / f"{jobs}.gcode"
        done = run(part, "-o", out, "--max-error", "25um", "--jobs", str(jobs), "--predict", "off")
        assert done.returncode == 0, done.stderr
        made.append(out.read_bytes())
    assert made[0] == made[1]


def test_a_profile_asks_for_it_and_an_option_says_no(tmp_path: Path) -> None:
    """As a slicer calls it: no option, the file in place."""
    part, mine = tmp_path / "in.gcode", tmp_path / "mine.toml"
    mine.write_text('extends = "paper"\n[speed]\nmax_error = 0.2\n[plant]\ninvented = false\n')
    for options, faster in ((), True), (("--max-error", "off"), False):
        part.write_bytes(b"".join(cube()))
        done = run(part, "-p", mine, *options, "--json", tmp_path / "s.json")
        assert done.returncode == 0, done.stderr
        printed = json.loads((tmp_path / "s.json").read_text())
        assert ("speed" in printed) == faster
    piped = run("-", "-p", mine)
    assert piped.returncode == 2
    assert b"--max-error off" in piped.stderr


def test_a_profile_bounds_acceleration_and_corners_of_the_path(
    known: Printer, loose: Report
) -> None:
    """As `setup` writes it from max_accel: the same time, however large the error may be."""
    mine = replace(known, speed=replace(known.speed, acceleration=3000.0))
    slow = fast(mine, 0.1)
    assert slow.time.after > loose.time.after
    assert slow.time.after == pytest.approx(slow.time.before, rel=0.05)


@pytest.mark.parametrize("slope", [0.15, 0.4, 1.0, 3.0])
@pytest.mark.parametrize("share", [0.1, 0.8, 1.5, 6.0])
def test_the_bound_is_reached_in_few_trials(slope: float, share: float) -> None:
    """Also where the error hardly depends on the acceleration, so that a step changes little."""
    shares, factor, best = dict[float, float](), 1.0, 0.0
    for _ in range(8):
        shares[factor] = share * factor**slope
        best = max([factor for factor, used in shares.items() if used <= 1.0], default=0.0)
        if (found := next_factor(shares)) is None:
            break
        factor = found
    reachable = (1.0 / share) ** (1.0 / slope)
    if reachable < 1.0 / 16.0:
        assert not best
    else:
        assert shares[best] >= NEAR or best == FASTEST
