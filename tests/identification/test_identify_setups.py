"""Other ways to measure: sensors on the bridge, one place, files of other programs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from hframe_post.printer import profile as profiles
from hframe_post.printer.settings import Printer
from tests.identification.bench import (
    LEFT,
    MAP,
    ON_BRIDGE,
    RIGHT,
    Recorded,
    invoked,
    nozzle,
    off,
    recorded,
)
from tests.page.pages import data_of


def check_racking(done: Result, mine: Path, taken: Recorded, paper: Printer, within: float) -> None:
    assert done.exit_code == 0, done.output
    found = profiles.load(str(mine)).plant
    assert off(found.Gxtheta, paper.plant.Gxtheta, taken.x[0][0].motors) <= within


@pytest.mark.slow
def test_two_sensors_on_the_bridge_measure_racking(
    taken: Recorded, tmp_path: Path, paper: Printer
) -> None:
    mine, report = tmp_path / "mine.toml", tmp_path / "report.html"
    one_place = nozzle(taken.x[1], taken.y)
    done = invoked(*MAP, *one_place, *taken.bridge, "--x-c", "140", "-o", mine, "--report", report)
    check_racking(done, mine, taken, paper, 0.05)
    assert profiles.load(str(mine)).plant.x_c == 140.0
    assert "x_c was not measured" in done.output
    shown = data_of(report)
    titles = [section["title"] for section in shown["sections"]]
    assert [title[title.index("(") :] for title in titles] == ["(Gxx)", "(Gyy)", "(Gxθ)"]
    lines = shown["sections"][0]["charts"][0]["lines"]
    assert [line["label"] for line in lines] == ["x = 140 mm", "model"]
    assert any("x_c was not measured" in warning for warning in shown["warnings"])


@pytest.mark.slow
def test_one_sensor_moved_along_the_bridge_measures_racking(
    taken: Recorded, tmp_path: Path, paper: Printer
) -> None:
    played = taken.x[1][0]
    earlier, later = (
        replace(ON_BRIDGE, clock=clock, drift=drift)
        for clock, drift in ((7.0, -0.003), (500.0, 0.005))
    )
    P1 = recorded(played, paper.plant, earlier, tmp_path, 8, RIGHT)
    P2 = recorded(played, paper.plant, later, tmp_path, 9, LEFT)
    ends: list[str | Path] = ["--bridge", played.command, P1, P2, "--bridge-length", "260"]
    mine = tmp_path / "mine.toml"
    check_racking(invoked(*MAP, *taken.all, *ends, "-o", mine), mine, taken, paper, 0.05)


@pytest.mark.slow
def test_without_places_or_bridge_the_profile_cancels_ringing_only(
    taken: Recorded, tmp_path: Path
) -> None:
    mine = tmp_path / "mine.toml"
    done = invoked(*MAP, *nozzle(taken.x[1], taken.y), "-o", mine)
    assert done.exit_code == 0, done.output
    assert "racking was not measured" in done.output
    assert profiles.load(str(mine)).plant.Gxtheta is None


@pytest.mark.slow
def test_other_files_in_other_units_are_read(taken: Recorded, tmp_path: Path) -> None:
    """The start of such recordings is unknown: the profile is usable, with a warning."""
    arguments: list[str | Path] = []
    for k, (played, path) in enumerate((*taken.x, taken.y)):
        rows = np.loadtxt(path, delimiter=",")
        late = np.concatenate([np.repeat(rows[:1], 800, axis=0), rows])
        late[:800, 0] = rows[0, 0] - np.arange(800, 0, -1) * 3.125e-4
        columns = (late / [1.0, 9806.65, 9806.65, 9806.65]).T
        names = dict(zip(("time", "ax", "ay", "az"), columns, strict=True))
        np.savez(tmp_path / f"{k}.npz", **names)
        arguments += ["--nozzle", played.command, tmp_path / f"{k}.npz"]
    mine = tmp_path / "mine.toml"
    more = ("--columns", "time,ax,ay,az", "-o", mine)
    done = invoked(*MAP, *arguments, *more)
    assert done.exit_code == 0, done.output
    assert profiles.load(str(mine)).plant.Gxtheta is not None
    assert "start" in done.output
