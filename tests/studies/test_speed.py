"""The fastest print within an error: the bound holds, and less error takes more time."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import SampleStream, Trial
from hframe_post.errors import HframeError
from hframe_post.model.plant import Plant
from hframe_post.planner.pacing import ADJUSTED, FIRST_LAYERS, NAMES
from hframe_post.prediction.predict import judge
from hframe_post.prediction.statistics import ErrorStatistics, Labels
from hframe_post.printer.settings import Extruder, Printer
from hframe_post.stream.features import kind
from hframe_post.studies.speed_drive import Drive
from hframe_post.studies.speed_search import Fastest, search, speed_rows
from hframe_post.studies.speed_steps import LIMIT, NEAR, Bound, Searches
from hframe_post.studies.speed_trial import JUDGED_EVERY, Freedom, SpeedSettings, TrialPrint
from hframe_post.studies.uncertainty import draws
from tests.command_line import run
from tests.conftest import SAMPLES
from tests.quantities import below

MODEL_ERROR = 0.05


def whole_cube() -> list[bytes]:
    return (SAMPLES / "cube.gcode").read_bytes().splitlines(keepends=True)


def cube() -> list[bytes]:
    """The first and two later layers; extrusion is relative."""
    lines = whole_cube()
    second, fifth, seventh = (lines.index(b";LAYER:%d\n" % number) for number in (1, 4, 6))
    return [*lines[:second], *lines[fifth:seventh]]


def found(paper: Printer, error: float, speed_up: float = 1.0) -> Fastest:
    freedom = Freedom(speed_up, paper.limits.filament_velocity, paper.limits.min_layer_time)
    drawn = tuple(draws(paper.plant, MODEL_ERROR, 20, 0))
    return search(cube, paper, Options("racking"), Bound(error), freedom, drawn)


@pytest.fixture(scope="module")
def loose(paper: Printer) -> Fastest:
    return found(paper, 0.2, 2.0)


@pytest.fixture(scope="module")
def tight(paper: Printer) -> Fastest:
    return found(paper, 0.08, 2.0)


def test_less_error_takes_more_time_and_less_than_the_file(loose: Fastest, tight: Fastest) -> None:
    assert loose.trial.seconds < tight.trial.seconds < loose.original.seconds
    assert loose.original.seconds == tight.original.seconds


def judged(fast: Fastest, plant: Plant, every: int) -> tuple[float, dict[str, float]]:
    """Convert again; return the seconds, and the 95th percentile of the error (mm) by feature."""
    trial = Trial(fast.paces)
    commands = SampleStream(cube(), fast.printer, Options("racking"), trial=trial)
    labels, errors = Labels(), dict[str, ErrorStatistics]()
    for judgement in judge(commands, plant, every):
        layer, feature = (numbers[judgement.at] for numbers in labels.number(judgement.chunk))
        for number in np.unique(feature).tolist():
            contour = judgement.contour["racking"][(feature == number) & (layer > FIRST_LAYERS)]
            errors.setdefault(kind(labels.features[number]), ErrorStatistics()).add(contour)
    return commands.report().duration, {name: of.percentile(0.95) for name, of in errors.items()}


@pytest.mark.parametrize("which", ["loose", "tight"])
def test_the_bound_holds_computed_anew(which: str, request: pytest.FixtureRequest) -> None:
    fast: Fastest = request.getfixturevalue(which)
    seconds, errors = judged(fast, fast.printer.plant, JUDGED_EVERY)
    assert seconds == pytest.approx(fast.trial.seconds)
    for name, (of_model, *of_drawn) in fast.trial.errors.items():
        assert errors[name] == pytest.approx(of_model)
        assert max(of_model, *of_drawn) <= fast.bound.limit(name)


def test_no_layer_is_too_short_and_the_limit_is_said(paper: Printer, loose: Fastest) -> None:
    least = paper.limits.min_layer_time
    for number, seconds in loose.trial.layers.items():
        assert seconds > 0.97 * min(least, loose.original.layers[number])
    assert loose.trial.limited.sum() == pytest.approx(loose.trial.seconds, rel=1e-9)
    assert loose.trial.limited_by["file"] > 0.0
    printed = "\n".join(map(str, speed_rows(loose)))
    assert re.search(r"permitted; \d+ without hframe-post", printed)


@pytest.mark.slow
def test_a_bound_on_the_width_of_lines_holds_and_takes_time(paper: Printer) -> None:
    """On the model and the worst of printers near it, with pressure in the hot end."""
    printer, options = replace(paper, extruder=Extruder(0.05)), Options("racking", ("racking",))
    drawn = tuple(draws(paper.plant, MODEL_ERROR, 8, 0))
    even, any_width = (
        search(cube, printer, options, Bound(0.1, width=width), near=drawn)
        for width in (0.08, math.inf)
    )
    assert even.trial.widths.keys() == even.trial.errors.keys()
    below(max(max(each) for each in even.trial.widths.values()), 0.08, "error of the width")
    assert not any_width.trial.widths
    assert even.trial.seconds > any_width.trial.seconds
    widths = (found.report.width["racking"].rms for found in (even, any_width))
    below(next(widths), next(widths), "RMS error of the width")
    assert "8 permitted" in "\n".join(map(str, speed_rows(even)))
    with pytest.raises(HframeError, match=r"off by .* of their width, .*--max-width-error"):
        search(cube, printer, options, Bound(10.0, width=1e-4))


def test_layers_take_as_long_as_in_a_plan_of_the_whole_print(paper: Printer) -> None:
    drive = Drive(lambda: whole_cube()[:4000], paper, Options("racking"), "p95", Freedom())
    before = SpeedSettings(dict.fromkeys(ADJUSTED, 5e3), dict.fromkeys(ADJUSTED, 1.0))
    after = replace(before, layer_feed={4: 0.7, 5: 0.6, 9: 0.8})
    times = drive.layer_times(before)
    again = drive.layer_times_again(after, before, times)
    assert again == pytest.approx(drive.layer_times(after), abs=1e-9)
    assert again[5] > 1.3 * times[5]
    known = {**times, 20: 100.0}  # not what a plan gives, so it shows what is planned again
    assert drive.layer_times_again(after, before, known)[20] == 100.0


@pytest.mark.slow
def test_same_bytes_each_time_and_whatever_the_processes(tmp_path: Path) -> None:
    part = tmp_path / "in.gcode"
    part.write_bytes(b"".join(cube()))
    made = []
    for jobs in (1, 2):
        out = tmp_path / f"{jobs}.gcode"
        options = (
            "--max-error",
            "100um",
            "--speed-up",
            "max",
            "--jobs",
            str(jobs),
            "--predict",
            "off",
        )
        done = run(part, "-o", out, *options)
        assert done.returncode == 0, done.stderr
        made.append(out.read_bytes())
    assert made[0] == made[1]


def test_a_profile_asks_for_it_and_an_option_says_no(tmp_path: Path) -> None:
    """As a slicer calls it: no option, the file in place."""
    part, mine = tmp_path / "in.gcode", tmp_path / "mine.toml"
    mine.write_text(
        'extends = "paper"\n[speed]\nmax_error = { outer-wall = 0.05, infill = 0.3 }\n'
        "speed_up = 2.0\nmodel_error = 0.0\n[plant]\ninvented = false\n"
    )
    for options, faster in ((), True), (("--max-error", "off"), False):
        part.write_bytes(b"".join(cube()))
        done = run(part, "-p", mine, *options, "--json", tmp_path / "s.json")
        assert done.returncode == 0, done.stderr
        printed = json.loads((tmp_path / "s.json").read_text())
        assert ("speed" in printed) == faster
    piped = run("-", "-p", mine)
    assert piped.returncode == 2
    assert b"--max-error off" in piped.stderr


def test_a_profile_bounds_acceleration_and_corners_of_the_path(paper: Printer) -> None:
    """As `setup` writes it from max_accel; without it the motors alone bound them."""

    def fastest(most: float) -> tuple[float, float]:
        mine = replace(paper, speed=replace(paper.speed, acceleration=most))
        drive = Drive(lambda: [], mine, Options("racking"), "p95", Freedom())
        asked = SpeedSettings(dict.fromkeys(ADJUSTED, 2e4), dict.fromkeys(ADJUSTED, 1.0))
        kinds = drive.configured(asked)[1].kinds.values()
        return max(pace.acceleration for pace in kinds), max(pace.corner for pace in kinds)

    owners = paper.limits.square_corner_velocity
    assert fastest(4000.0) <= (4000.0, owners)
    assert fastest(20.0 * 1e3)[1] == owners
    assert fastest(0.0) > (2e4 - 1.0, owners)


@pytest.mark.parametrize("slope", [0.15, 0.4, 1.0, 3.0])
@pytest.mark.parametrize("start", [(8e3,), (500.0, 20e3), (20e3, 500.0)])
def test_accelerations_take_few_trials(slope: float, start: tuple[float, ...]) -> None:
    """Also where the error hardly depends on the acceleration, so that a step changes little."""
    bound, used = Bound(0.1), 0.0

    def tried(acceleration: float) -> TrialPrint:
        error = 0.1 * (acceleration / 4e3) ** slope
        settings = SpeedSettings({"skin": acceleration}, {"skin": 1.0})
        return TrialPrint(settings, {"skin": [error]}, {}, 1.0, {}, np.zeros((len(NAMES), 1)), 0)

    searches = Searches(bound, 1e6, [tried(acceleration) for acceleration in start])
    for _ in range(5):
        used = bound.shares(searches.trials[-1])["skin"]
        if NEAR <= used <= LIMIT:
            break
        searches.trials.append(tried(searches.corrected({"skin": 1.0}).acceleration["skin"]))
    assert NEAR <= used <= LIMIT
