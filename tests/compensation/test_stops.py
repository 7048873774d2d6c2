"""At stops the command stands still, on the path or off it; next to them the print is traced."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post.arrays import TS, Array
from hframe_post.compensation.compensate import SETTLED, compensate, settling_samples
from hframe_post.compensation.stops import LONGEST, StopModels, dwell_at_stops, stop_rules
from hframe_post.conversion.pipeline import prepared
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.model.strategies import Compensator
from hframe_post.planner.lookahead import plan
from hframe_post.planner.sampling import sample
from hframe_post.prediction.predict import judge
from hframe_post.printer.profile import load
from hframe_post.printer.settings import STOPS, Printer, Travel
from hframe_post.stream.chunks import join, stretches
from hframe_post.stream.types import Dwell, Samples, StopRules
from tests.gcode_tools import HEAD, planned, strokes
from tests.paths import stroke

NAMES = ("fbs", "racking")


def models(printer: Printer, names: tuple[str, ...] = NAMES) -> StopModels:
    bounds = printer.travel, printer.motors, printer.kinematics
    return StopModels(prepared(printer), names, *bounds)


def compensated(chunks: Iterable[Samples], printer: Printer) -> list[Samples]:
    commands = compensate(chunks, prepared(printer), NAMES)
    return list(dwell_at_stops(commands, models(printer)))


def whole_stretches(chunks: Iterable[Samples]) -> list[Samples]:
    """Return the stretches in which anything moves."""
    return [block for block in (join(list(s)) for s in stretches(chunks)) if len(block) > 1]


def standstills(block: Samples) -> list[tuple[int, int]]:
    """Return the samples from the one before each pause to its last."""
    return [
        (max(e.index - 1 - block.first, 0), e.index + e.samples - block.first)
        for e in block.events
        if isinstance(e, Dwell)
    ]


def hardest(command: Array, printer: Printer) -> float:
    belts = printer.kinematics.belts(*command.T)
    return float(np.abs(np.diff(belts, n=2, axis=1)).max()) / TS**2


def errors(blocks: list[Samples], printer: Printer, name: str = "racking") -> Array:
    """Return the contour errors while extruding."""
    judged = list(judge([b for b in blocks if len(b)], printer.plant))
    return np.concatenate([j.contour[name][j.extruding] for j in judged])


@pytest.mark.parametrize("kind", ["fast", "exact"])
@pytest.mark.parametrize("lifts", [(), (0.4,)])
def test_the_command_stands_while_the_machine_waits(
    paper: Printer, kind: str, lifts: tuple[float, ...]
) -> None:
    printer = replace(paper, compensation=replace(paper.compensation, stops=kind))
    (block,) = whole_stretches(compensated(planned(strokes(0, 12, *lifts), printer), printer))
    assert len(standstills(block)) >= 24
    for name in NAMES:
        command = block.commands[name]
        for a, b in standstills(block):
            np.testing.assert_array_equal(command[a:b], np.tile(command[a], (b - a, 1)))
        np.testing.assert_allclose(command[[0, -1]], block.xyze[[0, -1], :2], atol=1e-9)
        assert hardest(command, printer) <= printer.motors.belt_acceleration


@settings(max_examples=12, deadline=None)
@given(
    st.integers(0, 1000),
    st.lists(
        st.sampled_from(
            ["G1 X{x} Y{y} E0.5 F6000", "G0 X{x} Y{y} F12000", "G0 X{nx} Y{ny} F12000",
             "G1 E-2 F2400", "G1 E2 F2400", "G1 Z{z} F900", "G4 P3", "G4 P400", "G4 P1500", "G10",
             "M104 S200", "M600"]
        ),
        max_size=24,
    ),
)  # fmt: skip
def test_any_sequence_of_stops_stands_still_within_the_limits(seed: int, body: list[str]) -> None:
    """Long and short waits, pauses in a row, moves of 20 µm between stops, released machines."""
    printer, rng, lines = load("paper"), np.random.default_rng(seed), list(HEAD)
    x, y = 100.0, 100.0
    for text in body:
        nx, ny = np.round(np.array([x, y]) + rng.uniform(-0.02, 0.02, 2), 3)
        fx, fy = np.round(rng.uniform(20, 250, 2), 3)
        lines.append(text.format(x=fx, y=fy, nx=nx, ny=ny, z=round(rng.uniform(0.2, 3), 2)))
        x, y = (fx, fy) if "{x}" in text else (nx, ny) if "{nx}" in text else (x, y)
        if text == "M600":
            lines.append(f"G0 X{x} Y{y} Z1 F6000")
    blocks = compensated(planned(lines, printer), printer)
    assert [b.first for b in blocks] == np.cumsum([0, *map(len, blocks[:-1])]).tolist()
    for block in whole_stretches(blocks):
        for name in NAMES:
            command = block.commands[name]
            assert np.isfinite(command).all()
            for a, b in standstills(block):
                np.testing.assert_array_equal(command[a:b], np.tile(command[a], (b - a, 1)))
            np.testing.assert_allclose(command[[0, -1]], block.xyze[[0, -1], :2], atol=1e-9)
            assert hardest(command, printer) <= printer.motors.belt_acceleration


@pytest.mark.parametrize("joined", [False, True])
def test_the_path_rests_at_stops_unless_firmware_passes_into_them(joined: bool) -> None:
    rules = {kind: stop_rules(kind, "racking", StopRules(joined=joined)) for kind in STOPS}
    assert [each.before for each in rules.values()] == [0 if joined else STOPS["fast"], 8]
    assert stop_rules("fast", "none", StopRules(before=3)) == StopRules(before=3)


def test_a_long_wait_is_made_on_the_path(paper: Printer) -> None:
    lines = [*HEAD, "G1 X90 Y60 E1 F6000", f"G4 P{LONGEST + 500}", "G1 X90 Y90 E1"]
    (block,) = whole_stretches(compensated(planned(lines, paper), paper))
    waits = [(a, b) for a, b in standstills(block) if b - a > LONGEST]
    assert len(waits) == 1
    for a, b in waits:
        np.testing.assert_array_equal(block.commands["racking"][a:b], block.xyze[a:b, :2])


def test_stops_cost_little_and_the_print_is_exact(paper: Printer) -> None:
    """Retractions of 67 ms every half second, at 10 000 mm/s² in any direction."""
    blocks = compensated(planned(strokes(1, 40), paper), paper)
    uncompensated = sum(len(b) for b in planned(strokes(1, 40), paper, "none"))
    off = errors(blocks, paper)
    assert sum(map(len, blocks)) <= 1.025 * uncompensated
    assert np.sqrt(np.square(off).mean()) < 0.010
    assert np.quantile(off, 0.95) < 0.020
    assert off.max() < 0.150


def test_exact_stops_are_more_exact_and_take_longer(paper: Printer) -> None:
    exact = replace(paper, compensation=replace(paper.compensation, stops="exact"))
    fast, slow = (compensated(planned(strokes(1, 20), p), p) for p in (paper, exact))
    assert sum(map(len, slow)) > sum(map(len, fast))
    rms = [np.sqrt(np.square(errors(blocks, paper)).mean()) for blocks in (fast, slow)]
    assert rms[1] < 0.9 * rms[0]


def test_no_peak_next_to_a_short_travel_or_at_a_corner_just_after_a_stop(paper: Printer) -> None:
    """29 ms of travel between two stops, which motors can just do; a zigzag of 0.5 mm."""
    fast = replace(paper.limits, acceleration=20_000.0, square_corner_velocity=20.0)
    stroke = ["G1 E-1.6 F2400", "G1 Z0.7 F1200", "G0 X{} Y{} F12000", "G1 Z0.3", "G1 E1.6 F2400"]
    short = [*HEAD, "G0 X52.439 Y36.557 F12000", "G1 X55.763 Y22.892 E0.56 F6000"]
    short += [line.format(54.007, 20.0) for line in stroke]
    short += ["G1 X34.864 Y20 E0.77 F6000", *(line.format(74.536, 29.633) for line in stroke)]
    zigzag = [*HEAD, "G0 X102.819 Y104.221 F9000", "G1 Z0.4 F600"]
    zigzag += [line.format(98.679, 106.525) for line in stroke]
    x = [97.992, 98.104, 97.55, 97.9, 97.553, 97.886, 97.956, 97.797]
    y = [106.772, 107.313, 108.368, 108.761, 111.653, 112.176, 112.654, 113.224]
    zigzag += [f"G1 X{a} Y{b} E0.02 F3600" for a, b in zip(x, y, strict=True)]
    for lines, limits in ((short, fast), (zigzag, paper.limits)):
        printer = replace(paper, limits=limits)
        blocks = compensated(planned(lines, printer), printer)
        assert errors(blocks, printer).max() < 0.130
        assert max(hardest(b.commands["racking"], printer) for b in blocks if len(b) > 2) <= 50_000


def test_a_wait_of_hours_is_not_kept_in_memory(paper: Printer) -> None:
    """Half an hour in chunks: nothing but the surroundings of its ends is kept."""
    lines = [*HEAD, "G1 X90 Y60 E1 F6000", "G4 P1800000", "G1 X90 Y90 E1"]
    raw = (line.encode() + b"\n" for line in lines)
    items = read(raw, ReadOptions.from_printer(paper, "printer"))
    taken = returned = buffered = 0

    def counted() -> Iterable[Samples]:
        nonlocal taken
        for chunk in sample(plan(items, paper.limits), paper.limits, stop_rules("fast", "racking")):
            taken += len(chunk)
            yield chunk

    commands = compensate(counted(), prepared(paper), ("racking",))
    for chunk in dwell_at_stops(commands, models(paper, NAMES[1:])):
        returned += len(chunk)
        buffered = max(buffered, taken - returned)
    assert returned == taken > 1_800_000
    assert buffered < 200_000


def test_settling_covers_the_fastest_stop(compensator: Compensator) -> None:
    limits = replace(load("paper").limits, velocity=150.0, acceleration=5000.0)
    reached = Travel((140.0, 280.0), (0.0, 280.0))  # x_c is 140: a lever arm of 140 mm
    r = settling_samples(compensator, limits, reached)
    x = stroke(75, 150, 1000)
    path = np.column_stack([280.0 - x.max() + x, x, np.zeros((len(x), 2))])
    samples = Samples(0, path, np.zeros(len(x), dtype=np.int64))
    done = join(list(compensate([samples], compensator, ("racking",))))
    off = np.abs(done.commands["racking"] - path[:, :2]).max(axis=1)
    assert (off[-1000 + r + 5 :] < 1.2 * SETTLED).all(), "mm"
    assert (off[: 1000 - r - 5] < 1.2 * SETTLED).all(), "mm"
    assert off[-1000 + r - 20] > 0.8 * SETTLED, "mm"
