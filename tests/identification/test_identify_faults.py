"""Refusals and warnings of `identify`: wrong files, wrong axes, broken recordings."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.identification.recordings.accelerometer import Recording
from hframe_post.printer.settings import Printer
from tests.identification.bench import (
    AXES,
    MAP,
    SENSOR,
    Played,
    Recorded,
    check_refused,
    invoked,
    nozzle,
    recorded,
)
from tests.page.pages import data_of
from tests.recordings import write_klipper


def changed(source: Path, folder: Path, change: Callable[[Array], Array]) -> Path:
    """Write the recording after ``change`` of its rows (n, 4), and return the file."""
    rows = change(np.loadtxt(source, delimiter=","))
    return write_klipper(folder / "changed.csv", Recording(rows[:, 0], rows[:, 1:], False))


@pytest.mark.slow
def test_exchanged_files_are_refused(taken: Recorded, tmp_path: Path) -> None:
    x, recorded_x = taken.x[0]
    y, recorded_y = taken.y
    check_refused(tmp_path, "not in", *MAP, *nozzle((x, recorded_y), (y, recorded_x)))


def test_wrong_axes_are_refused(taken: Recorded, tmp_path: Path) -> None:
    check_refused(tmp_path, "not in", "--axes", "x=x,y=y,z=z", *taken.all)
    check_refused(tmp_path, "would be\\s+tilted", "--axes", "x=x,y=z,z=-y", *taken.all)
    check_refused(tmp_path, "invalid axis map", "--axes", "up", *taken.all)


def test_recordings_without_the_sweep_or_cut_or_clipped_are_refused(
    taken: Recorded, tmp_path: Path
) -> None:
    x, path = taken.x[0]
    rng = np.random.default_rng(5)

    def silent(rows: Array) -> Array:
        still = np.array([0.0, 0.0, 9806.65])
        return np.column_stack([rows[:, 0], still + rng.normal(0.0, 100.0, (len(rows), 3))])

    for message, change in (
        ("does not follow", silent),
        ("shorter|ends .* before", lambda rows: rows[: len(rows) // 2]),
        ("clipped", lambda rows: np.clip(rows, [-np.inf, -3000, -3000, -np.inf], np.inf)),
        ("missing", lambda rows: np.delete(rows, slice(9000, 9400), axis=0)),
    ):
        bad = changed(path, tmp_path, change)
        axes = "x=x,y=y,z=z" if change is silent else AXES
        check_refused(tmp_path, message, "--axes", axes, *nozzle((x, bad), taken.y))


def test_another_sweeps_recording_is_refused(
    taken: Recorded, tmp_path: Path, paper: Printer
) -> None:
    """The same frequencies, but falling."""
    x, _ = taken.x[0]
    backwards = recorded(Played(x.command, x.motors[::-1]), paper.plant, SENSOR, tmp_path, 3)
    check_refused(tmp_path, "does not follow", *MAP, *nozzle((x, backwards), taken.y))


@pytest.mark.slow
def test_noise_alone_costs_no_warning(taken: Recorded, tmp_path: Path, paper: Printer) -> None:
    noisy = replace(SENSOR, noise=12.0)
    runs = [
        (played, recorded(played, paper.plant, noisy, tmp_path, 20 + k))
        for k, (played, _) in enumerate((taken.x[1], taken.y))
    ]
    done = invoked(*MAP, *nozzle(*runs))
    assert done.exit_code == 0, done.output
    warnings = [line for line in done.output.splitlines() if line.startswith("WARNING")]
    assert [line for line in warnings if "racking was not measured" not in line] == []


@pytest.mark.slow
def test_a_plant_that_no_window_compensates_is_refused(taken: Recorded, tmp_path: Path) -> None:
    """The measurement is reported all the same."""
    weak = tmp_path / "weak.toml"
    weak.write_text('extends = "paper"\n[motors]\nbelt_acceleration = 600.0\n')
    summary, page = tmp_path / "summary.json", tmp_path / "page.html"
    more = (*nozzle(taken.x[1], taken.y), "--json", summary, "--report", page)
    check_refused(tmp_path, "no window", "-p", weak, *MAP, *more)
    assert "windows" not in json.loads(summary.read_text())
    assert data_of(page)["lead"].endswith("No profile can be made from these recordings.")


def test_usage_and_files_are_checked(taken: Recorded, tmp_path: Path) -> None:
    (x0, recorded0), *_ = taken.x
    check_refused(tmp_path, "not the command of a motion", *MAP, "--nozzle", recorded0, recorded0)
    check_refused(tmp_path, "Give the command first", *MAP, "--nozzle", recorded0, x0.command)
    check_refused(tmp_path, "does not exist", *MAP, "--nozzle", "no.csv", recorded0, status=2)
    check_refused(tmp_path, "--nozzle", *MAP, status=2)
    check_refused(tmp_path, "four names", *taken.all, "--columns", "t,x", status=2)
    check_refused(tmp_path, "--band", *taken.all, "--band", "50", "5", status=2)
