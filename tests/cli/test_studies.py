"""simulate and tune as their users meet them: processes, files, exit statuses."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner

from hframe_post.cli.main import main
from hframe_post.cli.options import share
from hframe_post.cli.tune import weight
from hframe_post.printer.model_file import model_path
from hframe_post.printer.profile import load, shipped
from tests.command_line import run
from tests.conftest import SAMPLES

RECTANGLE = SAMPLES / "rectangle.gcode"
SMALL_TUNE = ("-L", "10", "--effort", "100", "--draws", "0", "--keep-limits")  # one, on the model
STRATEGIES = {"none", "fbs", "racking"}


def printed(done: CompletedProcess[bytes]) -> Any:
    assert done.returncode == 0, done.stderr.decode()
    return json.loads(done.stdout)


def refused(done: CompletedProcess[bytes], status: int, cause: str) -> None:
    """One line of cause, or click's usage; never a traceback."""
    error = done.stderr.decode()
    assert done.returncode == status, error
    assert cause in error
    assert "Traceback" not in error
    if status == 1:
        assert error.count("\n") == 1


# ---------------------------------------------------------------------- simulate


@pytest.fixture(scope="module")
def simulation() -> Any:
    return printed(run("simulate", RECTANGLE, "--json", "-", "-q"))


def test_simulate_tells_what_a_conversion_does_and_by_layer_and_feature(simulation: Any) -> None:
    conversion = printed(run(RECTANGLE, "-n", "-q", "--predict", "all", "--json", "-"))
    assert simulation.keys() - conversion.keys() == {
        "simulated_plant", "quantised", "strategies", "features", "layers", "model_error",
    }  # fmt: skip
    unwritten = {"lines_written", "busiest_second_lines", "against"}
    assert conversion.keys() - simulation.keys() == unwritten
    assert simulation["filament_mm"] == {"before": conversion["filament_mm"]["before"]}
    for key in conversion.keys() - unwritten - {"filament_mm", "command"}:
        assert simulation[key] == conversion[key], key
    assert simulation["simulated_plant"] == "measured"
    assert set(simulation["layers"]) >= {"0"}
    assert set(simulation["features"]) >= {"WALL-OUTER"}
    for part in (simulation, *simulation["layers"].values(), *simulation["features"].values()):
        figures = part.get("strategies", part)
        assert set(figures) == STRATEGIES
        for of_strategy in figures.values():
            assert set(of_strategy) - {"print_time_s"} == {
                "contour_error_um", "line_width_error_percent", "tracking_error_um",
                "peak_belt_speed", "peak_belt_acceleration",
            }  # fmt: skip
    times = {name: printed["print_time_s"] for name, printed in simulation["strategies"].items()}
    assert times["none"] < times["fbs"] == times["racking"]


def test_simulate_writes_nothing_but_the_summary(tmp_path: Path) -> None:
    part = tmp_path / "part.gcode"
    part.write_bytes(RECTANGLE.read_bytes())
    done = run("simulate", part, "--json", tmp_path / "s.json")
    assert done.returncode == 0
    assert "\n4 moves, " in done.stdout.decode()
    assert b"WALL-OUTER" in done.stdout
    assert not done.stderr
    assert part.read_bytes() == RECTANGLE.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["part.gcode", "s.json"]


def test_simulate_reads_standard_input_and_is_quiet() -> None:
    done = run("simulate", "-", "-q", stdin=RECTANGLE.read_bytes())
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


def test_without_a_file_the_rectangle_is_simulated(simulation: Any) -> None:
    path = printed(run("simulate", "--json", "-", "-q"))
    assert set(path["contour_error_um"]) == STRATEGIES
    for name, figures in path["contour_error_um"].items():
        elsewhere = simulation["contour_error_um"][name]
        assert figures.pop("all") == pytest.approx(elsewhere["all"], rel=0.02)
        assert figures == pytest.approx({k: elsewhere[k] for k in figures}, rel=0.02)


def test_simulate_under_model_error_on_steps_and_another_plant(tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text('extends = "paper"\n[plant]\nx_c = 150.0\n')
    arguments = ["simulate", "--model-error", "5%", "--model-error", "0.02"]
    arguments += ["--draws", "3", "--steps", "--plant", str(other), "--json", "-"]
    first, again = run(*arguments), run(*arguments)
    assert first.stdout == again.stdout
    summary = printed(first)
    assert (summary["simulated_plant"], summary["quantised"]) == ("other", True)
    assert [error["share"] for error in summary["model_error"]] == [0.05, 0.02]
    for error in summary["model_error"]:
        assert error["printers"] == 3
        for name in STRATEGIES:
            assert set(error[name]) == {"median_um", "worst_um", "better_than_none"}
            assert error[name]["median_um"] <= error[name]["worst_um"]
    assert b"median of 3 printers" in first.stderr  # standard output is the JSON's


# ---------------------------------------------------------------------- tune


def test_tune_recommends_and_writes_a_profile_that_loads(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    text = shipped()["paper"]
    mine.write_text(text, encoding="utf-8")
    done = run(
        "tune", "-p", mine, "-L", "10", "--effort", "30", "--effort", "300",
        "--draws", "2", "--json", tmp_path / "t.json", "--figure", tmp_path / "t.svg", "-o", mine,
        "--keep-limits",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr.decode()
    assert "recommended: L = 10, n_C = 44, n_up = 22" in done.stdout.decode()
    assert done.stdout.decode().count("→") == 2  # of the candidates, of the stops
    summary = json.loads((tmp_path / "t.json").read_text())
    assert (summary["draws"], summary["model_error"], len(summary["trials"])) == (2, 0.05, 2)
    assert [each["stops"] for each in summary["stops"]] == ["fast", "exact"]
    best = summary["recommended"]
    assert best in summary["trials"]
    x, y = load(str(mine)).compensation.windows
    assert [x.L, x.n_C, x.n_up] == [best["L"], best["n_C"], best["n_up"]]
    assert [x.effort, y.effort] == best["effort"]
    assert load(str(mine)).invented
    assert (tmp_path / "t.svg").read_text().startswith("<?xml")
    assert len(list(tmp_path.iterdir())) == 4


@pytest.mark.slow
def test_tune_chooses_acceleration_and_jerk_by_time_against_error(tmp_path: Path) -> None:
    out = tmp_path / "out.toml"
    done = run(
        "tune", "-L", "8", "--effort", "10", "--draws", "2",
        "--json", tmp_path / "t.json", "--figure", tmp_path / "t.svg", "-o", out,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr.decode()
    printed = json.loads((tmp_path / "t.json").read_text())
    seconds = [point["seconds"] for point in printed["pareto"]]
    error = [point["median_under_model_error_um"] for point in printed["pareto"]]
    assert seconds == sorted(seconds)
    assert error == sorted(error, reverse=True)
    chosen = printed["chosen"]
    assert chosen in printed["pareto"]
    # worth it: no other point halves the error for a tenth of the time
    cost = [e * t ** (np.log(2.0) / np.log(1.1)) for e, t in zip(error, seconds, strict=True)]
    assert chosen == printed["pareto"][int(np.argmin(cost))]
    advice = done.stderr.decode()
    for name in ("acceleration", "deceleration", "jerk"):
        assert f"{name} = {chosen[name]}" in advice
    assert load(str(out)).compensation.L == 8
    shown = done.stdout.decode()
    assert "best with the profile's limits: L = 8" in shown
    assert "\nrecommended: acceleration = " in shown
    assert shown.count("recommended") == 1, shown


def test_tune_recommends_no_limits_where_no_layer_has_a_label(tmp_path: Path) -> None:
    source = tmp_path / "part.gcode"
    source.write_text("G28\nM83\nG0 X60 Y60 Z0.3 F9000\nG1 X90 Y80 E2\nG1 X60 E2\n")
    done = run("tune", source, *SMALL_TUNE[:-1])
    assert done.returncode == 0, done.stderr.decode()
    assert "recommended: L = 10" in done.stdout.decode()
    assert "time against error" not in done.stdout.decode()


def test_tune_extends_a_shipped_profile_and_tells_refused_candidates(tmp_path: Path) -> None:
    out = tmp_path / "out.toml"
    arguments = [
        "-L",
        "10",
        "--effort",
        "0",
        "--effort",
        "100",
        "--keep-limits",
    ]
    summary = printed(
        run("tune", *arguments, "-L", "200", "--draws", "0", "--json", "-", "-o", out)
    )
    refused_trials = [trial for trial in summary["trials"] if "refused" in trial]
    assert refused_trials
    assert summary["model_error"] == 0.0
    assert tomllib.loads(out.read_text())["extends"] == "paper"
    assert summary["recommended"]["L"] == load(str(out)).compensation.L


def test_tune_recommends_nothing_that_the_motors_cannot_follow(tmp_path: Path) -> None:
    weak, out = tmp_path / "weak.toml", tmp_path / "out.toml"
    weak.write_text('extends = "paper"\n[motors]\nbelt_acceleration = 100.0\n')
    done = run("tune", "-p", weak, *SMALL_TUNE, "-o", out)
    refused(done, 1, "no candidate stays within the motors' limits")
    assert b"recommended" not in done.stdout
    assert not out.exists()


# ---------------------------------------------------------------------- what goes wrong

BOTH = pytest.mark.parametrize("command", ["simulate", "tune"])


@pytest.mark.parametrize(
    ("command", "text", "cause"),
    [
        ("simulate", None, "part.gcode: No such file"),
        ("simulate", b"", "the file is empty"),
        ("simulate", b"\x7fELF\x00\x00\n", "not a text file"),
        ("tune", None, "part.gcode: No such file"),
        ("tune", b"\x7fELF\x00\x00\n", "not a text file"),
    ],
)
def test_a_bad_print_is_one_line_and_nothing_written_but_the_failure(
    command: str, text: bytes | None, cause: str, tmp_path: Path
) -> None:
    part = tmp_path / "part.gcode"
    if text is not None:
        part.write_bytes(text)
    more = [*SMALL_TUNE, "-o", str(tmp_path / "out.toml")] if command == "tune" else []
    done = run(command, part, "--json", tmp_path / "s.json", *more)
    refused(done, 1, cause)
    assert not done.stdout
    assert cause in json.loads((tmp_path / "s.json").read_text())["error"]
    written = ["s.json"] if text is None else [part.name, "s.json"]
    assert sorted(path.name for path in tmp_path.iterdir()) == written


USAGE = [
    (["simulate", "--model-error", "many"], "'many' is not a share"),
    (["simulate", "--seed", "-1"], "--seed"),
    (["tune", "-L", "1"], "-L"),
    (["simulate", "--draws", "0"], "--draws"),
    (["tune", "--model-error", "200%"], "'200%' is not a share"),
    (["tune", "--effort", "nan"], "'nan' is not a number"),
    (["tune", "--figure", "a.pdf"], "--figure must end in"),
    (["tune", "--seed", "-1"], "--seed"),
]


@pytest.mark.parametrize(("arguments", "cause"), USAGE, ids=lambda value: str(value)[-40:])
def test_wrong_usage_is_status_2(arguments: list[str], cause: str) -> None:
    """In this process: what click refuses is never run."""
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 2
    assert cause in done.stderr
    assert not done.stdout


@pytest.mark.parametrize(
    ("text", "value"), [("5%", 0.05), ("0.05", 0.05), ("0", 0.0), ("99.9%", 0.999), (" 5%", 0.05)]
)
def test_shares_are_percentages_or_numbers(text: str, value: float) -> None:
    assert share(text) == pytest.approx(value)


@pytest.mark.parametrize("text", ["", "%", "five", "-1%", "100%", "1", "nan", "nan%", "inf", "5%%"])
def test_other_shares_are_refused(text: str) -> None:
    with pytest.raises(click.BadParameter, match="is not a share"):
        share(text)


def test_a_share_without_its_percent_sign_is_answered_with_it() -> None:
    with pytest.raises(click.BadParameter, match="for 5 percent type 5%"):
        share("5")


def test_simulate_says_that_a_plant_is_invented(tmp_path: Path) -> None:
    profile = tmp_path / "my.toml"
    profile.write_text('extends = "paper"\n[plant]\ninvented = true\n')
    assert b"not your printer" in run("simulate", "-p", profile).stdout
    assert b"not your printer" not in run("simulate").stdout


@pytest.mark.parametrize("text", ["", "heavy", "-1", "-0.1", "nan", "inf", "1e15"])
def test_weights_are_numbers_that_a_profile_can_hold(text: str) -> None:
    assert (weight("0"), weight("1e3")) == (0.0, 1000.0)
    with pytest.raises(click.BadParameter, match="is not a number"):
        weight(text)


def test_a_plant_that_is_no_profile(tmp_path: Path) -> None:
    refused(run("simulate", RECTANGLE, "--plant", RECTANGLE), 1, "not valid TOML")


def test_steps_need_their_table(tmp_path: Path) -> None:
    before, _, rest = shipped()["paper"].partition("[steps]")
    stepless = tmp_path / "stepless.toml"
    stepless.write_text(before + rest[rest.index("[compensation]") :], encoding="utf-8")
    refused(run("simulate", RECTANGLE, "-p", stepless, "--steps"), 1, "steps: the table is missing")


@pytest.mark.parametrize(
    ("command", "option", "name"),
    [
        ("simulate", "--json", "s.json"),
        ("tune", "--figure", "t.png"),
        ("tune", "-o", "t.toml"),
    ],
)
def test_an_output_that_cannot_be_written_is_named(
    command: str, option: str, name: str, tmp_path: Path
) -> None:
    more = SMALL_TUNE if command == "tune" else ()
    done = run(command, *more, option, tmp_path / "no" / name)
    refused(done, 1, f"the folder {tmp_path / 'no'} does not exist")
    assert str(tmp_path / "no") in done.stderr.decode()
    assert not list(tmp_path.iterdir())


def test_tune_changes_its_own_profile_however_it_is_laid_out(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text('extends = "paper" # mine\ncompensation.L = 5 # dotted\n')
    done = run("tune", "-p", mine, *SMALL_TUNE, "-o", mine)
    assert done.returncode == 0, done.stderr.decode()
    assert mine.read_text() == 'model = "mine.model.toml"\nextends = "paper" # mine\n'
    assert load(str(mine)).compensation.L == 10
    assert sorted(tmp_path.iterdir()) == [model_path(mine), mine]
