"""What `identify` refuses or warns of: wrong files, wrong axes, broken recordings."""

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
    heard,
    invoked,
    nozzle,
)
from tests.recordings import write_klipper


def changed(source: Path, folder: Path, change: Callable[[Array], Array]) -> Path:
    """The recording after ``change`` of its rows (n, 4)."""
    rows = change(np.loadtxt(source, delimiter=","))
    return write_klipper(folder / "changed.csv", Recording(rows[:, 0], rows[:, 1:], False))


def unnamed(folder: Path, *recordings: Path) -> list[Path]:
    """The recordings under names that do not tell their places."""
    copies = [folder / f"recording-{k}.csv" for k in range(len(recordings))]
    for recording, copy in zip(recordings, copies, strict=True):
        copy.write_bytes(recording.read_bytes())
    return copies


@pytest.mark.slow
def test_exchanged_files_are_told(taken: Recorded, tmp_path: Path) -> None:
    """By their names; by the recordings' own marks where names tell nothing."""
    (x0, heard0), (x1, heard1), (x2, heard2) = taken.x
    y, heard_y = taken.y
    swapped = [*MAP, *nozzle((x0, heard2), (x1, heard1), (x2, heard0), taken.y)]
    check_refused(tmp_path, "is named as the recording of x-at-200", *swapped)
    heard0, heard2, heard_y = unnamed(tmp_path, heard0, heard2, heard_y)
    check_refused(tmp_path, "not in", *MAP, *nozzle((x0, heard_y), (y, heard0)))
    places = nozzle((x0, heard2), (x1, heard1), (x2, heard0), taken.y)
    check_refused(tmp_path, "files of two places\\s+exchanged", *MAP, *places)
    P1, P2 = taken.ends
    ends: list[str | Path] = ["--bridge", x1.command, P2, P1, "--bridge-length", "260"]
    check_refused(tmp_path, "P1\\s+must be the one", *MAP, *taken.all, *ends)


@pytest.mark.slow
def test_racking_that_two_ways_tell_differently_is_doubted(taken: Recorded) -> None:
    done = invoked(*MAP, *taken.all, *taken.bridge[:-1], "180")
    assert done.exit_code == 0, done.output
    assert "check --bridge-length" in done.output


def test_wrong_axes_are_told(taken: Recorded, tmp_path: Path) -> None:
    check_refused(tmp_path, "not in", "--axes", "x=x,y=y,z=z", *taken.all)
    check_refused(tmp_path, "left-handed", "--axes", "x=y,y=x,z=z", *taken.all)
    check_refused(tmp_path, "tilted", "--axes", "x=x,y=z,z=-y", *taken.all)
    check_refused(tmp_path, "no axis map", "--axes", "up", *taken.all)


def test_what_was_not_played_or_is_cut_or_clipped_is_told(taken: Recorded, tmp_path: Path) -> None:
    x, path = taken.x[0]
    rng = np.random.default_rng(5)

    def silent(rows: Array) -> Array:
        still = np.array([0.0, 0.0, 9806.65])
        return np.column_stack([rows[:, 0], still + rng.normal(0.0, 100.0, (len(rows), 3))])

    for told, change in (
        ("does not follow", silent),
        ("shorter|ends .* before", lambda rows: rows[: len(rows) // 2]),
        ("clipped", lambda rows: np.clip(rows, [-np.inf, -3000, -3000, -np.inf], np.inf)),
        ("missing", lambda rows: np.delete(rows, slice(9000, 9100), axis=0)),
    ):
        bad = changed(path, tmp_path, change)
        axes = "x=x,y=y,z=z" if change is silent else AXES
        check_refused(tmp_path, told, "--axes", axes, *nozzle((x, bad), taken.y))


def test_another_sweeps_recording_is_told(taken: Recorded, tmp_path: Path, paper: Printer) -> None:
    """The same frequencies, but falling."""
    x, _ = taken.x[0]
    backwards = heard(Played(x.command, x.motors[::-1]), paper.plant, SENSOR, tmp_path, 3)
    check_refused(tmp_path, "does not follow", *MAP, *nozzle((x, backwards), taken.y))


@pytest.mark.slow
def test_noise_alone_costs_no_warning(taken: Recorded, tmp_path: Path, paper: Printer) -> None:
    noisy = replace(SENSOR, noise=12.0)
    runs = [
        (played, heard(played, paper.plant, noisy, tmp_path, 20 + k))
        for k, (played, _) in enumerate((taken.x[1], taken.y))
    ]
    done = invoked(*MAP, *nozzle(*runs))
    assert done.exit_code == 0, done.output
    told = [line for line in done.output.splitlines() if line.startswith("WARNING")]
    assert [line for line in told if "racking was not measured" not in line] == []


@pytest.mark.slow
def test_orders_that_do_not_fit_are_told(taken: Recorded, tmp_path: Path) -> None:
    """What is measured is shown all the same, to be looked at."""
    told, drawn = tmp_path / "told.json", tmp_path / "f"
    one_place = nozzle(taken.x[1], taken.y)
    low = (*MAP, *one_place, "--order", "Gxx=1", "--json", told, "--figures", drawn)
    check_refused(tmp_path, "order 1 .*too low", *low)
    assert json.loads(told.read_text())["functions"]["Gxx"]["residual"] > 0.2
    assert (drawn / "Gxx.png").exists()
    done = invoked(*MAP, *one_place, "--order", "Gxx=10", "--json", "-")
    assert done.exit_code == 0, done.output


@pytest.mark.slow
def test_a_plant_that_no_window_compensates_is_told(taken: Recorded, tmp_path: Path) -> None:
    weak = tmp_path / "weak.toml"
    weak.write_text('extends = "paper"\n[motors]\nbelt_acceleration = 600.0\n')
    told = tmp_path / "told.json"
    one_place = nozzle(taken.x[1], taken.y)
    check_refused(tmp_path, "no window", "-p", weak, *MAP, *one_place, "--json", told)
    assert "windows" not in json.loads(told.read_text())


def test_usage_and_files_are_told(taken: Recorded, tmp_path: Path) -> None:
    (x0, heard0), *_ = taken.x
    check_refused(tmp_path, "no run .* sweeps y", *MAP, *nozzle(*taken.x))
    check_refused(tmp_path, "not the command of a sweep", *MAP, "--nozzle", heard0, heard0)
    check_refused(tmp_path, "no accelerometer file", *MAP, "--nozzle", x0.command, x0.command)
    check_refused(tmp_path, "--bridge-length", *MAP, *taken.all, *taken.bridge[:4], status=2)
    check_refused(tmp_path, "does not exist", *MAP, "--nozzle", "no.csv", heard0, status=2)
    check_refused(tmp_path, "--nozzle", *MAP, status=2)
    check_refused(tmp_path, "Gxx=4", *taken.all, "--order", "Gxx", status=2)
    check_refused(tmp_path, "four names", *taken.all, "--columns", "t,x", status=2)
    check_refused(tmp_path, "--band", *taken.all, "--band", "50", "5", status=2)
