"""The library: what ``import hframe_post`` offers, and that it is what the tool does."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from inspect import isclass, isfunction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hframe_post as hp
from examples.paper.results import path
from hframe_post.arrays import TS, Array
from hframe_post.conversion.pipeline import first_line
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from hframe_post.studies.simulation.uncertainty import draws
from hframe_post.writers.files import Outputs
from tests.conftest import MEASURED, SAMPLES
from tests.modes import deviation_of_mode

DESCRIPTORS = (property, classmethod, staticmethod)
VERBS = """Add Certify Check Compensate Compute Convert Find Identify Load Predict Raise Read
Recommend Return Run Simulate Solve Write Yield""".split()  # noqa: SIM905
RECTANGLE = SAMPLES / "rectangle.gcode"


def rms(error: Array) -> float:
    return float(np.sqrt(np.square(error).mean()))


def body(gcode: bytes) -> list[bytes]:
    """Lines without the stamp and the summary."""
    lines = gcode.splitlines()
    return [line for line in lines if not line.startswith((b"; processed", b"; hframe-post"))]


def stroke(start: tuple[float, float], by: tuple[float, float], n: int) -> Array:
    """A move from rest to rest, (n, 2)."""
    share = np.arange(n) / (n - 1)
    smooth = share - np.sin(2 * np.pi * share) / (2 * np.pi)
    moved: Array = np.asarray(start) + smooth[:, None] * np.asarray(by)
    return moved


# ---------------------------------------------------------------------- the package itself


def test_import_costs_nothing_until_a_name_is_used() -> None:
    program = (
        "import sys, hframe_post as hp; heavy = {'numpy', 'scipy', 'click', 'ruckig'};"
        "assert not heavy & set(sys.modules); assert set(hp.__all__) <= set(dir(hp));"
        "hp.TransferFunction; assert 'numpy' in sys.modules and 'ruckig' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.parametrize("name", hp.__all__)
def test_every_name_offered_is_there_and_says_what_it_is(name: str) -> None:
    """A dataclass without a docstring gets its signature as one, which says nothing."""
    offered = getattr(hp, name)
    if name != "__version__":
        assert offered.__doc__, f"{name} has no docstring"
        assert not offered.__doc__.startswith(f"{name}("), f"{name} has only a generated docstring"


@pytest.mark.parametrize("name", hp.__all__)
def test_functions_and_methods_are_documented_by_an_imperative_verb(name: str) -> None:
    offered = getattr(hp, name)
    functions = {name: offered} if isfunction(offered) else {}
    if isclass(offered):
        functions = {
            each: getattr(member, "fget", None) or getattr(offered, each)
            for each, member in vars(offered).items()
            if not each.startswith("_") and (callable(member) or isinstance(member, DESCRIPTORS))
        }
    for each, function in functions.items():
        doc = function.__doc__
        assert doc, f"{name}: {each} has no docstring"
        assert doc.split()[0] in VERBS, f"{name}: {each}: {doc.splitlines()[0]}"


def test_what_is_not_offered_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'compensation_of_all'"):
        _ = hp.compensation_of_all


# ---------------------------------------------------------------------- arrays


@pytest.mark.paper
def test_fig_9_through_arrays(paper: Printer) -> None:
    """The figures that the whole tool predicts for its G-code."""
    xy = path(paper)
    off = {
        name: rms(hp.contour_error(hp.predict(hp.compensate(xy, paper, name), paper), xy)) * 1e3
        for name in ("none", "fbs", "racking")
    }
    assert off["none"] == pytest.approx(242, abs=8)
    assert off["fbs"] == pytest.approx(117, abs=5)
    assert off["racking"] < 9.5


@pytest.mark.parametrize("strategy", ["none", "fbs", "racking"])
def test_command_begins_and_ends_at_rest_on_the_path(paper: Printer, strategy: str) -> None:
    xy = np.concatenate([stroke((60, 60), (140, 0), 700), stroke((200, 60), (0, 90), 500)])
    command = hp.compensate(xy.tolist(), paper, strategy)
    r, odd = divmod(len(command) - len(xy), 2)
    assert not odd
    assert r > 400  # the settling of the shipped printer's fastest stop
    for end, place in ((0, xy[0]), (-1, xy[-1])):
        assert np.abs(command[end] - place).max() <= 0.01
    if strategy == "none":
        np.testing.assert_array_equal(command[r:-r], xy)
    else:
        assert np.abs(command[r:-r] - xy).max() > 0.1


@pytest.mark.parametrize("name", ["paper", "example-corexy", "example-cartesian"])
@pytest.mark.parametrize("acceleration", [500.0, 3000.0, 10_000.0])
def test_strokes_get_as_much_rest_as_compensation_can_use(name: str, acceleration: float) -> None:
    """With a second of rest around it, a stroke begins and ends no more exactly."""
    profile = hp.load_printer(name)
    printer = replace(profile, limits=replace(profile.limits, acceleration=acceleration))
    up = np.arange(0.0, 60.0, acceleration * TS)  # mm/s
    s = TS * np.cumsum(np.concatenate([up, np.full(300, 60.0), up[::-1]]))
    xy = np.array([140.0, 100.0]) + s[:, None] * np.array([0.6, 0.8])
    rested = np.pad(xy, ((1000, 1000), (0, 0)), mode="edge")
    short, long = (
        hp.contour_error(hp.predict(hp.compensate(each, printer), printer), each)
        for each in (xy, rested)
    )
    for ends in (slice(0, 30), slice(-30, None)):
        worse = np.abs(short[ends]).max() - np.abs(long[1000:-1000][ends]).max()
        assert worse < 1e-3, f"{1e3 * worse:.2f} µm"


def test_a_single_place_is_a_path(paper: Printer) -> None:
    command = hp.compensate([[100.0, 50.0]], paper)
    np.testing.assert_allclose(command, np.tile([100.0, 50.0], (len(command), 1)), atol=1e-9)
    assert hp.contour_error(hp.predict(command, paper), [[100.0, 50.0]]).tolist() == [0.0]


def test_contour_error_is_the_distance_to_the_path_and_rests_do_not_count() -> None:
    xy = stroke((0, 0), (30, 40), 200)
    beside = xy + 0.1 * np.array([-0.8, 0.6])
    late = np.concatenate([xy[:1], xy[:-1]])
    far = np.full((50, 2), 1e3)
    np.testing.assert_allclose(hp.contour_error(beside, xy), 0.1, atol=1e-9)
    np.testing.assert_allclose(hp.contour_error(late, xy), 0.0, atol=1e-9)
    np.testing.assert_allclose(
        hp.contour_error(np.concatenate([far, beside, far]), xy), 0.1, atol=1e-9
    )


@pytest.mark.parametrize("n", [199, 201, 203])
def test_nozzle_that_does_not_belong_to_the_path_is_refused(n: int) -> None:
    with pytest.raises(hp.HframeError, match=f"{n} samples of the nozzle"):
        hp.contour_error(np.zeros((n, 2)), np.zeros((200, 2)))


@pytest.mark.parametrize(
    "wrong", [[], [1.0, 2.0], [[1.0, 2.0, 3.0]], [[0.0, np.nan]], np.zeros((0, 2)), [[1], [2, 3]]]
)
def test_what_is_no_path_is_refused(paper: Printer, wrong: list[float]) -> None:
    with pytest.raises(hp.HframeError, match="xy must be"):
        hp.compensate(wrong, paper)
    with pytest.raises(hp.HframeError, match="command must be"):
        hp.predict(wrong, paper)


def test_mistakes_in_arguments_are_value_errors_of_the_tool(paper: Printer) -> None:
    for mistake in (
        lambda: hp.TransferFunction(np.zeros(0, complex), np.array([1.2 + 0.0j]), 1.0),
        lambda: hp.Window(L=5, n_C=10, n_up=20, effort=1.0),
        lambda: hp.Lpfbs(paper.plant.Gxx, hp.Window(L=20, n_C=11, n_up=5, effort=0.0)),
        lambda: hp.compensate("a path", paper),
        lambda: hp.Lpfbs(paper.plant.Gxx, paper.compensation.windows[0]).command(np.zeros((5, 2))),
        lambda: hp.Options(limits="non"),  # type: ignore[arg-type]
        lambda: hp.simulate([b"G1 X1\n"], paper, model_error=(5,)),
        lambda: hp.tune([b"G1 X1\n"], paper, knots=(0,)),
    ):
        with pytest.raises(hp.HframeError) as raised:
            mistake()
        assert isinstance(raised.value, ValueError)


def test_unknown_strategies_and_profiles_are_the_tools_errors(paper: Printer) -> None:
    with pytest.raises(hp.HframeError, match="unknown strategy 'raking'"):
        hp.compensate(np.zeros((5, 2)), paper, "raking")
    with pytest.raises(hp.HframeError, match="no such profile"):
        hp.load_printer("nobody")


def test_another_printer_is_another_prediction(paper: Printer) -> None:
    xy = path(paper)
    command = hp.compensate(xy, paper)
    other = replace(paper, plant=draws(paper.plant, 0.05, 1, seed=0)[0])
    own, others = (hp.contour_error(hp.predict(command, p), xy) for p in (paper, other))
    assert rms(others) > 1.2 * rms(own)


# ---------------------------------------------------------------------- files


def test_convert_is_what_the_command_line_does(tmp_path: Path) -> None:
    report = hp.convert(RECTANGLE, tmp_path / "by_library.gcode", hp.load_printer(MEASURED))
    arguments = [sys.executable, "-m", "hframe_post", str(RECTANGLE), "-q"]
    subprocess.run([*arguments, "-o", str(tmp_path / "by_tool.gcode")], check=True)
    assert (tmp_path / "by_library.gcode").read_bytes() == (tmp_path / "by_tool.gcode").read_bytes()
    assert set(report.contour) == {"none", "shaper", "racking"}
    assert report.contour["racking"].rms < report.contour["none"].rms / 8


def test_convert_does_all_that_the_command_line_can(paper: Printer, tmp_path: Path) -> None:
    out, page = tmp_path / "by_library.gcode", tmp_path / "page.html"
    read = list[int]()
    options = hp.Options(
        force=True, firmware="klipper", tolerance=None, retract="moving",
        predict=("none", "fbs", "racking"), jobs=2,
    )  # fmt: skip
    report = hp.convert(
        RECTANGLE, out, replace(paper, invented=True), options, page=page,
        title="A rectangle", notes=["printed on the big one"], progress=read.append,
    )  # fmt: skip
    arguments = [sys.executable, "-m", "hframe_post", str(RECTANGLE), "-q", "--tolerance", "0"]
    by_tool = tmp_path / "by_tool.gcode"
    subprocess.run([*arguments, "--retract", "moving", "-o", str(by_tool)], check=True)
    by_both = [body(path.read_bytes()) for path in (out, by_tool)]
    assert by_both[0] == by_both[1]
    assert set(report.contour) == {"none", "fbs", "racking", "shaper"}  # the page's baseline
    assert sum(read) == RECTANGLE.stat().st_size
    assert b"A rectangle" in page.read_bytes()
    assert b"printed on the big one" in page.read_bytes()


def test_a_dry_run_writes_nothing(paper: Printer, tmp_path: Path) -> None:
    assert hp.convert(RECTANGLE, None, paper).lines_written
    assert not list(tmp_path.iterdir())


def test_the_first_line_is_known_before_the_conversion(paper: Printer, tmp_path: Path) -> None:
    out = tmp_path / "out.gcode"
    options = hp.Options("fbs", clamp=False)
    hp.convert(RECTANGLE, out, paper, options)
    assert first_line(paper, options.resolved(paper)) in out.read_bytes()
    assert first_line(paper, replace(options, clamp=True)) not in out.read_bytes()


def test_files_that_belong_together_appear_together(paper: Printer, tmp_path: Path) -> None:
    out = tmp_path / "out.gcode"
    with Outputs([RECTANGLE]) as outputs:
        hp.convert(RECTANGLE, out, paper, outputs=outputs)
        assert not out.exists()
    assert out.exists()


def test_other_formats_do_not_replace_the_source(paper: Printer, tmp_path: Path) -> None:
    part = tmp_path / "part.gcode"
    part.write_bytes(RECTANGLE.read_bytes())
    with pytest.raises(hp.HframeError, match="steps would replace the G-code"):
        hp.convert(part, part, paper, hp.Options(format="steps"))


def test_convert_takes_lines_and_writes_what_the_suffix_says(
    paper: Printer, tmp_path: Path
) -> None:
    lines = RECTANGLE.read_bytes().splitlines(keepends=True)
    hp.convert(lines, tmp_path / "out.csv", paper, hp.Options("fbs", ()))
    assert b"\n#printer,paper\n" in (tmp_path / "out.csv").read_bytes()
    report = hp.convert(lines, tmp_path / "out.npz", paper, hp.Options("none"))
    assert set(report.contour) == {"none"}
    with np.load(tmp_path / "out.npz") as table:
        np.testing.assert_array_equal(table["x_dm"], table["x_d"])


def test_convert_that_fails_leaves_the_target(paper: Printer, tmp_path: Path) -> None:
    target = tmp_path / "part.gcode"
    target.write_bytes(b"G1 X10 Y10 Z1 F6000\nG1 X1000\n")
    before = target.read_bytes()
    wrongs: list[dict[str, Any]] = [
        {},
        {"strategy": "raking"},
        {"predict": ("raking",)},
        {"format": "rtf"},
    ]
    for wrong in wrongs:
        with pytest.raises(hp.HframeError):
            hp.convert(target, target, paper, hp.Options(**wrong))
        assert target.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["part.gcode"]


def test_simulate_judges_every_strategy_and_drawn_printers(paper: Printer) -> None:
    report = hp.simulate(RECTANGLE, paper, model_error=(0.05, 0.2), draws=3, seed=1)
    assert report.strategies == ["none", "fbs", "racking"]
    five, twenty = report.model_error
    assert (five.share, twenty.share) == (0.05, 0.2)
    assert len(five.rms("racking")) == 3
    assert max(five.rms("racking")) < max(twenty.rms("racking"))


def test_whole_steps_need_their_table(paper: Printer) -> None:
    with pytest.raises(hp.HframeError, match="steps: the table is missing"):
        hp.simulate(RECTANGLE, replace(paper, steps=None), steps=True)
    assert hp.simulate(RECTANGLE, paper, steps=True).quantised


def test_tune_recommends_among_what_it_tried(paper: Printer) -> None:
    tuned = hp.tune(RECTANGLE, paper, knots=(5,), efforts=(30.0, 96.0), draws=1)
    assert [trial.windows[0].effort for trial in tuned.trials] == [30.0, 96.0]
    assert tuned.best in tuned.trials
    weak = replace(paper, motors=replace(paper.motors, belt_velocity=10.0))
    assert hp.tune(RECTANGLE, weak, knots=(5,), efforts=(96.0,), draws=0).best is None


def test_tune_needs_no_random_printers_where_the_model_says_how_well_it_is_known() -> None:
    """Its median and worst are then those of the range, unless a model error is asked for."""
    printer = load("example-corexy")
    x, y = (ImpulseResponse(deviation_of_mode(hz, 0.08, 400), 0, drift=0.02) for hz in (45.0, 38.0))
    known = replace(printer, plant=Plant(x, y, None, 0.0))
    (trial,) = hp.tune(RECTANGLE, known, knots=(5,), efforts=(10.0,)).trials
    assert not trial.drawn
    assert trial.contour.rms < trial.robust < trial.worst
    (asked,) = hp.tune(RECTANGLE, known, knots=(5,), efforts=(10.0,), model_error=0.05).trials
    assert len(asked.drawn) == 10
    assert asked.contour.range is None
