"""The printer's axes in those of a sensor, as the recording of a motion with marks shows them.

At low frequencies the printer follows its command, so a recording of both axes is

    a ≈ D·u + b,   D (3, 2): where x and y of the printer point, as the sensor sees them.

No mounting is wrong: a sensor on a bed that moves sees y the other way round, and owners mirror
axes in printer.cfg, since a spectrum does not show a sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import (
    AXES,
    PLAUSIBLE,
    Recording,
    at_rest,
)
from hframe_post.identification.recordings.alignment import acceleration
from hframe_post.identification.recordings.clock_sync import (
    RATE,
    Resampler,
    banded,
    clock_from_marks,
    find_marks,
    moving_samples,
    not_found,
)

SLOW_HZ = (2.0, 8.0)  # which any printer follows
QUIET = 0.5  # s at the start of a recording in which the printer is at rest
LEAST = 0.3  # share of the command that a sensor must show


def has_marks(command: Array) -> bool:
    """Return whether a command (m, 2) begins and ends with the marks of our own motions."""
    accelerations = (acceleration(along) for along in command.T if np.ptp(along) > 0.0)
    return any(find_marks(u, moving_samples(u)) is not None for u in accelerations)


def sensor_axes(command: Array, recording: Recording) -> Array:
    """Return the printer's axes as the sensor sees them: unit vectors x, y, z, in rows (3, 3).

    command (m, 2): mm every 1 ms, with marks. An axis that does not move is taken to be at right
    angles to the one that does and to gravity, right-handed. Raises IdentificationError if the
    recording does not follow the command.
    """
    moved = [axis for axis in (X, Y) if np.ptp(command[:, axis]) > 0.0]
    u = np.column_stack([acceleration(command[:, axis]) for axis in moved])
    found = ((v, find_marks(v, moving_samples(v))) for v in u.T)
    marked, marks = next((v, marks) for v, marks in found if marks is not None)
    rest = at_rest(recording, QUIET)
    sensor = Resampler(recording.t, recording.a - rest)
    track = sensor.resampled(0.0, 0.0, int(sensor.seconds * RATE) + 1)
    start, drift = clock_from_marks(marked, marks, track)
    slow, shown = (
        banded(values, SLOW_HZ) for values in (u, sensor.resampled(start, drift, len(u)))
    )
    D = np.asarray(np.linalg.lstsq(slow, shown, rcond=None)[0])
    if (np.linalg.norm(D, axis=1) < LEAST).any():
        raise not_found()
    return completed(D, moved, rest)


def completed(D: Array, moved: Sequence[int], rest: Array) -> Array:
    """Return all of the printer's axes, (3, 3), from those that moved: ``sensor_axes``.

    D (k, 3): where the axes that moved point, of any length; rest (3,): what the sensor shows at
    rest. Raises IdentificationError without gravity, if one axis moved.
    """
    D = D / np.linalg.norm(D, axis=1, keepdims=True)
    rows = np.zeros((3, 3))
    rows[list(moved)] = D
    strength = float(np.linalg.norm(rest))
    if len(moved) == 2:
        rows[2] = np.cross(rows[X], rows[Y])
        rows[2] *= np.sign(rows[2] @ rest) or 1.0
    elif PLAUSIBLE[0] <= strength <= PLAUSIBLE[1]:
        along = D[0]
        up = rest / strength - (along @ rest) / strength * along
        rows[2] = up / np.linalg.norm(up)
        rows[1 - moved[0]] = np.cross(rows[2], along) * (1.0 if moved[0] == X else -1.0)
    else:
        raise IdentificationError(
            f"at rest the sensor shows {strength / 1000.0:.4g} m/s² instead of gravity, so "
            "its axes are unknown. Name them: --axes x=x,y=y,z=z"
        )
    return rows


def nearest_map(axes: Array) -> str:
    """Return the axis map, as ``x=-y,y=x,z=z``, that is nearest to axes (3, 3) in rows."""
    order = max(permutations(range(3)), key=lambda p: sum(abs(axes[k, p[k]]) for k in range(3)))
    signs = ["-" if axes[k, at] < 0.0 else "" for k, at in enumerate(order)]
    return ",".join(f"{AXES[k]}={signs[k]}{AXES[at]}" for k, at in enumerate(order))
