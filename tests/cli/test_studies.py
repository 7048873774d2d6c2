"""simulate and tune as their users meet them: processes, files, exit statuses."""

from __future__ import annotations

import json
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import click
import pytest
from click.testing import CliRunner

from hframe_post.cli.main import main
from hframe_post.cli.options import share
from hframe_post.printer.model_file import model_path
from hframe_post.printer.profile import load, shipped
from tests.command_line import run
from tests.conftest import SAMPLES

RECTANGLE = SAMPLES / "rectangle.gcode"
SMALL_TUNE = ("-L", "10", "--effort", "100", "--draws", "0")  # one, on the model
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
        "--draws", "2", "--json", tmp_path / "t.json", "-o", mine,
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
    assert len(list(tmp_path.iterdir())) == 3


# ---------------------------------------------------------------------- what goes wrong


USAGE = [
    (["simulate", "--model-error", "many"], "'many' is not a share"),
    (["simulate", "--seed", "-1"], "--seed"),
    (["tune", "-L", "1"], "-L"),
    (["simulate", "--draws", "0"], "--draws"),
    (["tune", "--model-error", "200%"], "'200%' is not a share"),
    (["tune", "--effort", "nan"], "'nan' is not a number"),
    (["tune", "--figure", "a.pdf"], "--figure is gone: --json has the numbers"),
    (["tune", "--keep-limits"], "--keep-limits is gone"),
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


def test_tune_changes_its_own_profile_however_it_is_laid_out(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text('extends = "paper" # mine\ncompensation.L = 5 # dotted\n')
    done = run("tune", "-p", mine, *SMALL_TUNE, "-o", mine)
    assert done.returncode == 0, done.stderr.decode()
    assert mine.read_text() == 'model = "mine.model.toml"\nextends = "paper" # mine\n'
    assert load(str(mine)).compensation.L == 10
    assert sorted(tmp_path.iterdir()) == [model_path(mine), mine]
