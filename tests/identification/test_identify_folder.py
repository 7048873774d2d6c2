"""`identify` with a folder: what owners have, under the names that their tools gave."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from hframe_post.identification.gather import along_printer, from_folders
from hframe_post.identification.recordings.accelerometer import Recording, oriented, read
from hframe_post.identification.recordings.excitation import read_command
from hframe_post.identification.recordings.orientation import QUIET
from hframe_post.printer.settings import Printer
from tests.identification.bench import AXES, Recorded
from tests.recordings import write_klipper


def sweeps(taken: Recorded, folder: Path) -> Path:
    """Return a folder with commands and mirrored recordings, as `sweep` and Klipper name them."""
    folder.mkdir()
    for played, path in (*taken.x, taken.y):
        shutil.copy(played.command, folder)
        run = played.command.stem.rpartition(".")[2]
        rows = np.loadtxt(path, delimiter=",")
        rows[:, 1] *= -1.0
        write_klipper(folder / f"adxl345-{run}.csv", Recording(rows[:, 0], rows[:, 1:], True))
    return folder


def test_our_sweeps_need_neither_names_nor_axes(
    taken: Recorded, paper: Printer, tmp_path: Path
) -> None:
    """Not even where the owner has mirrored an axis in printer.cfg."""
    held = sweeps(taken, tmp_path / "held")
    gathered = along_printer(from_folders([held], None, paper.travel))
    assert gathered.aside == []
    assert len(gathered.runs) == 4
    runs = sorted(gathered.runs, key=lambda run: (run.axis, run.place))
    for run, (played, path) in zip(runs, (*taken.x, taken.y), strict=True):
        np.testing.assert_array_equal(run.command, read_command(played.command))
        assert run.nozzle is not None
        np.testing.assert_allclose(run.nozzle.a, oriented(read(path), AXES, QUIET).a, atol=1e-3)
