"""Other ways to measure: one place, files of other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hframe_post.printer import profile as profiles
from tests.identification.bench import MAP, Recorded, invoked, nozzle


@pytest.mark.slow
def test_without_places_the_profile_cancels_ringing_only(taken: Recorded, tmp_path: Path) -> None:
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
        in_g = late / [1.0, 9806.65, 9806.65, 9806.65]
        np.savetxt(tmp_path / f"{k}.txt", in_g, "%.7f", ",", header="s,1,2,3", comments="")
        arguments += ["--nozzle", played.command, tmp_path / f"{k}.txt"]
    mine = tmp_path / "mine.toml"
    more = ("--columns", "s,1,2,3", "-o", mine)
    done = invoked(*MAP, *arguments, *more)
    assert done.exit_code == 0, done.output
    assert profiles.load(str(mine)).plant.Gxtheta is not None
    assert "start" in done.output
