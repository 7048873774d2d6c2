"""What the owner of a simulated printer reads off a tower's walls with a ruler."""

import tomllib

import numpy as np
from scipy.signal import find_peaks

from hframe_post.identification.by_eye import Reading, corner_path
from hframe_post.identification.tower import SIDE, Band
from tests.simulator import Axis, Machine, Mode


def read(
    hz: float, damping: float, band: Band, acceleration: float, seen_from: float = 0.015
) -> Reading:
    """Return what an owner reads who does as the form says, measures to a tenth and counts halves.

    Crests are those on one side of the wall, from the corner on, of a printer in continuous time.
    """
    path, corner = corner_path(band, acceleration, SIDE)
    still = np.repeat(path[:1], 300, axis=0)
    axis = Axis((Mode(hz, damping),))
    moved = Machine(axis, axis, kinematics="cartesian").played(np.vstack([still, path]))
    across, along = moved[300 + corner :, :2].T
    half_waves, _ = find_peaks(np.abs(across))
    heights = np.abs(across[half_waves])
    crests = along[half_waves[::2]]
    seen = float((heights > seen_from).sum() / 2.0)
    waves = min(int((heights[::2] > seen_from).sum()) - 2, 5)
    if waves < 1:
        return Reading(band, 0.0, 0.0, seen)
    return Reading(band, round(float(crests[1 + waves] - crests[1]), 1), waves, seen)


def filled(form: str, hz: dict[str, float], damping: float = 0.06) -> str:
    """Return an empty form as filled in by the owner of a printer with a mode in x and in y."""
    printed = tomllib.loads(form)["print"]
    for k, (speed, corner) in enumerate(zip(printed["speeds"], printed["corners"], strict=True), 1):
        for axis, its_hz in hz.items():
            one = read(its_hz, damping, Band(speed, corner), printed["acceleration"])
            row = f"{axis}{k} = [{one.distance}, {one.waves:g}, {one.seen:g}]"
            form = form.replace(f"{axis}{k} = [0, 0, 0]", row)
    return form
