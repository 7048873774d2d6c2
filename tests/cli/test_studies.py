"""simulate as their users meet them: processes, files, exit statuses."""

import json
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import click
import pytest
from click.testing import CliRunner

from hframe_post.cli.main import main
from hframe_post.cli.parameters import share
from tests.command_line import run
from tests.conftest import SAMPLES

RECTANGLE = SAMPLES / "rectangle.gcode"
STRATEGIES = {"none", "fbs", "racking"}


def printed(done: CompletedProcess[bytes]) -> Any:
    assert done.returncode == 0, done.stderr.decode()
    return json.loads(done.stdout)


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


def test_standard_input_is_read_as_often_as_a_file(tmp_path: Path) -> None:
    arguments = ("--shapers", "--json", "-", "--report", tmp_path / "page.html")
    piped = run("simulate", "-", *arguments, stdin=RECTANGLE.read_bytes())
    assert printed(piped) == printed(run("simulate", RECTANGLE, *arguments))


USAGE = [
    (["simulate", "--model-error", "many"], "'many' is not a share"),
    (["simulate", "--seed", "-1"], "--seed"),
    (["simulate", "--draws", "0"], "--draws"),
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
