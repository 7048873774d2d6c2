"""Pressure advance: its lines, what it is along a path and within which limits, the stage."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import TS, Array, E, X
from hframe_post.compensation.advance import Advancing
from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.firmware.dialect import Advance, ExtruderLimits, klipper_advance, marlin_advance
from hframe_post.firmware.registry import firmware
from hframe_post.model.pressure_advance import NEAR, REACH, bounded, extruding, smoothed
from hframe_post.printer.profile import load, parse, shipped
from hframe_post.printer.settings import Extruder
from hframe_post.stream.types import Samples
from tests.gcode_tools import converted, sample
from tests.quantities import below

LIMITS = ExtruderLimits(40.0, 2000.0)
ADVANCES = {
    "Klipper's": (Advance(0.05, 0.04, klipper_advance), None),
    "ours": (Advance(0.05, 0.04, marlin_advance), LIMITS),
}


@pytest.fixture(scope="module")
def chunks() -> list[Samples]:
    """Return part of the cube, in which the advance changes."""
    lines = sample("cube.gcode")
    lines = lines[: lines.index(b";LAYER:1\n")][:160]
    for at, text in (
        (80, b"M900 K0.09\n"), (80, b"SET_PRESSURE_ADVANCE ADVANCE=0.09 SMOOTH_TIME=0.02\n"),
        (120, b"M900 K0\n"), (120, b"SET_PRESSURE_ADVANCE ADVANCE=0\n"),
    ):  # fmt: skip
        lines.insert(at, text)
    source = WholeFile(iter(lines), load("paper"), Options("none", limits="printer"))
    return list(source.samples())


def advances(chunks: Iterable[Samples], name: str) -> tuple[Array, Advancing]:
    stage = Advancing(*ADVANCES[name])
    found: Iterator[Array] = (
        np.zeros((len(c), 2)) if c.advance is None else c.advance for c in stage.samples(chunks)
    )
    return np.concatenate(list(found)), stage


@pytest.mark.parametrize("name", ADVANCES)
def test_lines_of_the_file_change_it(chunks: list[Samples], name: str) -> None:
    found, stage = advances(chunks, name)
    assert (stage.summary.least, stage.summary.most) == (0.0, 0.09)
    seconds = found[:, 1]
    assert {*np.unique(seconds)} == {0.0, 0.05, 0.09}
    assert np.argmax(seconds == 0.09) < np.argmax(seconds == 0.0)
    assert not found[-1].any()


@pytest.mark.parametrize(("extruder", "told"), [(2000.0, True), (4000.0, False)])
def test_the_summary_tells_where_klipper_outruns_the_extruder(extruder: float, told: bool) -> None:
    paper = load("paper")
    limits = replace(paper.limits, extruder_acceleration=extruder)
    printer = replace(paper, extruder=Extruder(0.05), limits=limits)
    _, report = converted(sample("rectangle.gcode"), printer)
    assert ("more than limits.extruder_acceleration (2000)" in report.as_text()) == told
    assert 2500.0 < report.advancing.hardest < 3500.0


HALF, VELOCITY, ACCELERATION = 10, 40.0, 2000.0
LINE = 4  # ms, about as long as a line of G-code
AROUND = REACH + NEAR + HALF


def lines(seed: int, count: int = 6) -> Array:
    """Return a path (n, 4) of lines whose speed changes at once, between travel and retractions."""
    rng, speed, flow = np.random.default_rng(seed), list[Array](), list[Array]()
    for _ in range(count):
        for _ in range(rng.integers(1, 5)):
            n = int(rng.integers(1, 300))
            speed.append(np.full(n, rng.uniform(0.0, 300.0)))
            flow.append(np.full(n, rng.uniform(0.01, 0.08)))
        gap = int(rng.integers(1, 60))
        speed += [np.full(gap, rng.choice([0.0, 120.0])), np.zeros(20)]
        flow += [np.zeros(gap), np.zeros(20)]
    v, per_mm = np.concatenate(speed), np.concatenate(flow)
    path = np.zeros((len(v) + 1, 4))
    path[1:, X], path[1:, E] = np.cumsum(v * TS), np.cumsum(v * per_mm * TS)
    path[:, E] -= np.cumsum(np.append(False, v == 0.0)) * 0.01  # retracted while it stands
    return np.vstack([np.repeat(path[:1], AROUND, axis=0), path])


def ours(path: Array, K: float = 0.05) -> Array:
    seconds = np.full(len(path), K)
    return bounded(path, seconds, VELOCITY, ACCELERATION, HALF)


@pytest.mark.parametrize("seed", range(8))
def test_the_extruder_stays_within_its_limits(seed: int) -> None:
    path = lines(seed)
    A = ours(path)
    inside = extruding(path)
    assert (A >= 0.0).all()
    fed = np.where(inside, np.diff(path[:, E]), 0.0) / TS
    added = np.diff(A) / TS
    below(np.abs(fed + added).max(), 1.1 * max(VELOCITY, fed.max()), "speed, mm/s")
    of_lines = np.diff(A[::LINE]) / (LINE * TS)
    sudden = np.abs(np.diff(of_lines)).max() / (LINE * TS)
    below(sudden, ACCELERATION, "acceleration of what is added, mm/s²")


@pytest.mark.parametrize("seed", range(4))
def test_no_filament_is_moved_out_of_a_line(seed: int) -> None:
    """It is exactly 0 at both ends of each, in travel and in retractions."""
    path = lines(seed)
    steps = extruding(path)
    outside = ~(np.append(False, steps) & np.append(steps, False))
    A = ours(path)
    assert A.max() > 0.1
    assert not A[outside].any()


def test_klippers_rule_is_a_mean_of_place_and_speed() -> None:
    """With weights that fall in both directions, of filament that retractions do not move."""
    path = lines(5)
    fed = np.where(extruding(path), np.diff(path[:, E]), 0.0)
    filament, speed = np.append(0.0, np.cumsum(fed)), np.append(0.0, fed) / TS
    half, K = 20, 0.07
    weight = 21.0 - np.abs(np.arange(-half, half + 1.0))
    mean = np.convolve(filament + K * speed, weight / weight.sum(), "valid")
    found = smoothed(path, np.full(len(path), K), half)[half:-half]
    np.testing.assert_allclose(found, mean - filament[half:-half], atol=1e-9)


@pytest.mark.parametrize(
    ("line", "seconds", "smooth_time"),
    [
        (b"SET_PRESSURE_ADVANCE ADVANCE=0.05", 0.05, None),
        (b"set_pressure_advance extruder=extruder advance=.04 SMOOTH_TIME=0.02 ; PLA", 0.04, 0.02),
        (b"SET_PRESSURE_ADVANCE EXTRUDER=extruder1 ADVANCE=0.05", None, None),
        (b"SET_PRESSURE_ADVANCE ADVANCE=-1", None, None),
        (b"SET_PRESSURE_ADVANCE ADVANCE=soft", None, None),
        (b"; SET_PRESSURE_ADVANCE ADVANCE=0.05", None, None),
        (b"M900 K0.05", None, None),
    ],
)
def test_lines_that_set_it_for_klipper(
    line: bytes, seconds: float | None, smooth_time: float | None
) -> None:
    assert klipper_advance(line) == (seconds, smooth_time)


@pytest.mark.parametrize(
    ("line", "seconds"),
    [
        (b"M900 K0.05", 0.05), (b"N12 m900 k.2*71", 0.2), (b"M900 T0 K1", 1.0),
        (b"M900 T1 K1", None), (b"M900", None), (b"M900 K99", None), (b"M9001 K1", None),
        (b";M900 K1", None), (b"SET_PRESSURE_ADVANCE ADVANCE=0.05", None),
    ],
)  # fmt: skip
def test_lines_that_set_it_for_marlin(line: bytes, seconds: float | None) -> None:
    assert marlin_advance(line) == (seconds, None)


def test_a_profile_comes_before_what_marlin_has_stored() -> None:
    text = shipped()["paper-marlin"].replace("linear_advance = 0.0 ", "linear_advance = 0.03 ")
    text = text.replace('extends = "paper"', 'extends = "paper"', 1)
    stored, own = parse(text, "stored"), parse(f"{text}\n[extruder]\nadvance = 0.07\n", "own")
    for printer, seconds in ((stored, 0.03), (own, 0.07), (load("paper-marlin"), 0.0)):
        assert firmware(printer).advance() == Advance(seconds, 0.04, marlin_advance)
